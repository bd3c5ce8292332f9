"""The tasks that the coordinator leases to this worker, and batches of other workers' tasks.

``task_runner`` fetches the inputs of a lease, lets ``task_process`` run the task (its program is
`atoll.tasks.process`), pushes the result in chunks, and keeps the result until the coordinator releases the task.
"""
