"""The tasks that workers run in processes of their own: preparing a table, refining a job, analysing its model.

``functions`` names them and what each needs loaded: `atoll_coordinator.tasks` has those of a search, from bytes to
bytes, and ``analyses`` what can be asked of a result; ``team`` gives batches of a task's work to other workers that
help with it; ``process`` is the program that a worker starts, which runs one task after another. Nothing here knows the
service or the bus.

A lease comes to a worker -> its process gets a `atoll_core.task_frames.Run` -> `functions.FUNCTIONS` -> `Finished`.
"""
