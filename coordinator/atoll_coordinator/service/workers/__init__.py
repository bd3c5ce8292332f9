"""Workers, and which worker computes what.

`worker_controller` handles what happens to workers; `membership` has their states and leases; `crash_loops` counts
their deaths by archipelago, reserves workers for quarantined ones, and makes leases longer for slow ones; `placing`
plans placements and corrects what workers have; `stalls` finds why there is no progress; `channel` sends.

Heartbeat -> `worker_controller` -> `membership` -> `placing.corrections` -> `channel`.
Lost worker -> `membership` -> `crash_loops` -> `placing.Scheduler` -> placements through `channel`.
"""
