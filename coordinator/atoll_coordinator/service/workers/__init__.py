"""Workers, and the assignment of islands to workers.

`worker_controller` handles events of workers; `membership` has their states and leases; `crash_loops` counts their
deaths by archipelago, reserves workers for quarantined ones, and makes leases longer for slow ones; `placing` plans
placements and corrects the holdings of workers; `stalls` finds causes of missing progress; `channel` sends.

Heartbeat -> `worker_controller` -> `membership` -> `placing.corrections` -> `channel`.
Lost worker -> `membership` -> `crash_loops` -> `placing.Scheduler` -> placements through `channel`.
"""
