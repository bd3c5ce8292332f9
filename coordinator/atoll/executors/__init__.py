"""Jobs on an executor of another library instead of the service: Dask, MPI, loky, Ray, pools of processes or threads.

The driver of a job is in the caller's process and has no bus. It uses the same parts as the service: the state machine
of a job, the collector, the epoch of an island, the task process with its batches. So the results are the same to the
bit (ADR 0100). All tasks are pure functions; a task whose worker was killed is submitted again.

``executors`` adapts what users give (the only code about particular libraries). ``dispatcher`` submits tasks, sends
shared data once to each process, and submits lost tasks again. ``tasks`` has the functions that run on the workers.
``batches`` gives batches of any other work to an executor. ``epochs`` has the epochs of islands as batches, ``driver``
takes one job from its table to its result.

The path of a job: `atoll.discover` -> `driver.solve` -> `dispatcher.Dispatcher` -> (a worker) `tasks.perform`.
"""
