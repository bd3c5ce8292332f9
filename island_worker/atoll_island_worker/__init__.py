"""The island worker: one process that computes islands for a coordinator.

- ``cli``, ``launch``: the command line; one worker in this process, or several under ``processes``.
- ``worker``: the loop. Events of the bus go to ``session``, its actions to the bus and the compute thread; heartbeats.
- ``connection``: handshake, absence, drain, and the requests to the coordinator and other workers.
- ``job_logs``: lines of the log on their way to the coordinator.
- ``datasets``: what is fetched for a job before its islands can be computed.
- ``session``: what is computed, sent and answered next (pure). ``compute``: the thread that computes.
- ``evolution``: the search itself; knows nobody.

A migrant leaves ``evolution`` in a computed epoch, goes through ``compute``, ``session`` and ``connection`` to another
worker's session, and from there with the task of the next epoch back into ``evolution``. When the compute thread fails,
or the coordinator stays away, the loop ends with an exit code and a sentence; the supervisor starts the process again.
"""
