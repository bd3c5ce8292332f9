"""The compute thread of a worker: tasks in, results out, islands in between.

- ``compute_thread``: takes commands from the worker's loop, posts results; it ends with an error or not at all.
- ``run_queue``: the tasks that are not done; they take turns of one slice, and a hit ends those not needed (pure).
- ``engine``: the datasets and islands themselves; begins an epoch, and makes its report and emigrants.
- ``warmup``: compiles or loads the kernels before work comes.

A task goes from the session's action to the queue, slice by slice through ``engine`` to
`atoll_island_worker.evolution`; its result is posted to the bus and comes back to the session as an event.
"""
