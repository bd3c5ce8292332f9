"""The tasks that workers run in separate processes: preparing a table, refining a job, analysing its model.

``functions`` has the table of tasks and the modules that each needs: the tasks of a search are in
`atoll_coordinator.tasks`, the questions about a result in ``analyses``. ``process`` is the program that a worker
starts: it runs one task after another, and gives batches of a task's work to workers that help. Nothing here knows the
service or the bus.

A lease comes to a worker -> its process gets a `atoll_core.task_frames.Run` -> `functions.FUNCTIONS` -> `Finished`.
"""
