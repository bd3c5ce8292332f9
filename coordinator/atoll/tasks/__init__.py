"""The tasks that workers run in separate processes: preparing a table, refining a job, analysing its model.

``functions`` has the table of tasks, and the modules that each task needs: `atoll_coordinator.tasks` for the tasks of a
search, ``analyses`` for questions about a result. ``process`` is the program that a worker starts: it runs one task
after another, and gives batches of a task's work to workers that help. This package does not import the service or the
bus.

The path of a task: a worker gets a lease -> its task process gets `atoll_core.task_frames.Run` -> `functions.FUNCTIONS`
-> `Finished`.
"""
