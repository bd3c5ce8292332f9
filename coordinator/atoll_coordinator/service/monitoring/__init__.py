"""What people are shown. Nothing here decides anything.

``event_log`` records what happens to jobs and workers, in the program's log and in the store; ``counters`` counts what
live jobs cost, ``breakages`` what broke; ``views`` makes what `coordinator jobs`, `status` and `result` show of a job,
and ``job_views`` has it made of all jobs, live or ended; ``drafts`` are what results are composed of;
``queue_depth`` is how much work waits.
``followers`` tells clients of each change, and ``metrics`` has what Prometheus reads.

JobController, `workers` -> `EventLog`, `CounterRegistry`; `Job` -> `views.job_view` or `drafts.draft_of` ->
`JobViews` -> clients.
"""
