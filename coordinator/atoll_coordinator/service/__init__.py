"""The running coordinator: jobs, workers, results.

``service_loop`` is the only loop; it passes events of the bus to ``job_controller`` and ``requests``. Below them,
``tasks`` leases tasks to workers, ``workers`` places islands on workers, ``monitoring`` has views, events and metrics,
``scheduling`` decides which job is next, ``jobs`` has the states of a job, ``search`` the state of an archipelago, and
``store`` is the durable memory. A package imports only packages that come later in this list. Terms: a *placement*
assigns the islands of a search to workers, and a *term* is its number; a *cut* is the stored end of the search for one
equation; a *lease* (of a worker, a task, an upload or a follower) ends unless messages renew it.

A job: `requests.clients` -> `job_controller.submit` -> `scheduling.job_queue` -> `tasks.task_controller` (prepare) ->
`job_controller` (search) -> `workers.placement` -> `search.collector` (cut) -> `tasks.task_controller` (refine) ->
`job_controller` (end) -> `store`.
A task: `tasks.task_controller` -> `tasks.task_table` (plan) -> a lease -> a worker's result -> `tasks.background`.
A report: `service_loop` -> `job_controller.add_report` -> `jobs.job` -> `search.archipelago` -> `search.collector`.
A worker's death: `workers.worker_controller` -> `workers.membership` (expire) -> `workers.crash_loops` ->
`workers.placement` -> a placement under a new term.
A commit: heartbeat with snapshots -> `search.pull_budget` (pulls) -> `search.checkpoint_schedule` (gathering) ->
`tasks.background` -> `job_controller` (commit) -> `workers.channel`.
"""
