"""The tasks of jobs that are leased to workers: preparing, refining.

``task_table`` has the tasks and their states (pure), ``dispatch`` says which task goes to which worker and who helps
with which (pure), ``task_controller`` sends leases, takes in what workers say of them, and posts outcomes to the
service's loop. ``outcomes`` are these, and ``results`` reads them. ``background`` works on large values, on a thread of
its own: it reads results of tasks, and composes those of jobs that are not refined. ``dependencies`` names all that a
test puts in the place of clock and thread.

A job is to be prepared -> `task_controller.TaskController.prepare` -> `dispatch.plan` -> Lease -> a worker's result ->
`background.Background.read_result` -> `task_controller.TaskController.take_result` -> `JobPrepared` is posted.
"""
