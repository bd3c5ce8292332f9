"""The tasks that the coordinator leases to this worker, and batches of other workers' tasks.

``task_runner`` fetches the inputs of a lease, has ``task_process`` run the task (the program in the process is
`atoll.tasks.process`), pushes the result in chunks, and keeps it until the coordinator releases the task.
"""
