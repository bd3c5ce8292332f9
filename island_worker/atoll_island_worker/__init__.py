"""The island worker: one process that computes islands and tasks for a coordinator.

- ``cli``: the command line; one worker in this process, or several that ``processes`` watches.
- ``worker``: the loop. It hands events of the bus to ``session``, and the session's actions to the bus and to the
  compute thread; it sends heartbeats.
- ``connection``: handshake, absence of the coordinator, drain, and all requests to the coordinator and other workers.
- ``downloads``: bytes that are fetched in chunks, among them the datasets of jobs. ``job_logs``: log lines that are
  sent to the coordinator.
- ``session``: decides what is computed, sent and answered next (pure). ``compute``: the thread that computes.
- ``tasks``: the process that prepares data and refines equations. ``evolution``: the search itself.

The path of a migrant: it leaves ``evolution`` when an epoch ends, passes ``compute``, ``session`` and ``connection``,
reaches the session of another worker, and enters ``evolution`` there with the task of the next epoch. When the compute
thread fails or the coordinator stays away, the loop ends with an exit code and a reason, and the supervisor starts the
process again.
"""
