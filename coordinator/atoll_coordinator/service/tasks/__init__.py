"""The tasks of jobs that are leased to workers: preparing, refining, and questions about results.

`task_table` has the tasks, their states and the plan of leases (pure). `task_controller` sends leases, handles workers'
reports, and posts outcomes to the service's loop. `analyses` has the questions (pure). `background` works on large
values in a separate thread, and defines the outcomes.

A job is to be prepared -> `TaskController.prepare` -> `task_table.plan_leases` -> Lease -> a worker's result ->
`Background.read_result` -> `TaskController.take_result` -> `JobPrepared` is posted.
"""
