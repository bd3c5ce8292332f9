"""The island worker: one process that computes islands and tasks for a coordinator.

- ``cli``: the command line; one worker in this process, or several that ``processes`` watches.
- ``worker``: the loop. It passes events from the bus to ``session``, passes the session's actions to the bus and to the
  compute thread, and sends heartbeats.
- ``connection``: handshake, absence of the coordinator, drain, and all requests to the coordinator and to other
  workers.
- ``downloads``: bytes that are fetched in chunks, such as the datasets of jobs. ``job_logs``: log lines for the
  coordinator.
- ``session``: decides what is computed, sent and answered next (pure). ``compute``: the thread that computes.
- ``tasks``: the process that prepares data and refines equations. ``evolution``: the search itself.

The path of a migrant: it leaves ``evolution`` when an epoch ends, passes ``compute``, ``session`` and ``connection``,
reaches the session of another worker, and enters ``evolution`` there with the task of the next epoch. If the compute
thread fails, or if the coordinator is away too long, the loop ends with an exit code and a reason, and the supervisor
starts the process again.
"""
