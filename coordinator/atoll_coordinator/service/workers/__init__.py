"""Workers, and the assignment of islands to workers.

`worker_controller` handles events of workers. `membership` has the states and leases of workers. `crash_loops` counts
deaths of workers by archipelago, reserves workers for quarantined archipelagos, and lengthens leases of slow workers.
`placement` plans placements and corrects the holdings of workers. `stalls` finds causes of missing progress. `channel`
sends messages.

Heartbeat -> `worker_controller` -> `membership` -> `placement.corrections` -> `channel`.
Lost worker -> `membership` -> `crash_loops` -> `placement.Placer` -> placements through `channel`.
"""
