"""The tasks that the coordinator leases to this worker, and those of other workers that it helps with.

- ``task_runner``: what is leased here, its inputs and results, and batches between workers.
- ``task_process``: the process that runs them, `atoll.tasks.process`, as this worker sees it.
- ``task_server``: a process that has loaded what tasks need, and forks task processes for the workers of a machine.
- ``downloads``: bytes by digest, fetched chunk by chunk and checked.

A lease comes -> its inputs are fetched -> the process runs it -> its result is pushed in chunks, and kept until the
coordinator releases the task.
"""
