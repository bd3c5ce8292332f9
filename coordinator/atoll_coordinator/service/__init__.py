"""The coordinator at work: jobs, workers, results.

``service`` is the only loop; it hands what the bus brings to ``controller`` and ``requests``. Below them, ``workers``
has who computes what, ``background`` the slow work, ``monitoring`` what people are shown, ``jobs`` a job and the
queue, ``search`` an archipelago, and ``store`` what lasts. Imports go down this list only.

A job: `requests.clients` -> `controller.submit` -> `jobs.queue` -> `background.runner` (prepare) ->
`controller.start_search` -> `workers.scheduling` -> `search.collector` (cut) -> `background.runner` (refine) ->
`controller.finish_job` -> `store`.
A report: `service` -> `controller.add_report` -> `jobs.job` -> `search.archipelago` -> `search.collector`.
A worker's death: `workers.controller` -> `workers.membership` (expire) -> `workers.lease_backoff`,
`workers.crash_loops` -> `workers.quarantine`, `workers.scheduling` -> a placement under a new term.
A commit: heartbeat with snapshots -> `search.pull_budget` (pulls) -> `search.checkpoints` ->
`background.runner` (write) -> `controller.commit_checkpoint` -> `workers.channel`.
"""
