"""The workers, and who computes what.

``worker_controller`` takes in what happens to workers and has the others decide. ``membership`` knows who is there and
notices who is lost; ``lease_backoff`` makes leases longer for slow work. ``crash_loops`` counts deaths by archipelago,
``quarantine`` reserves workers for those that cost too many. ``scheduling`` plans placements, ``reconciliation``
compares heartbeats with them, ``stalls`` finds who is waited for. ``channel`` sends,
``worker_logs`` attaches to jobs what workers log of them.

Heartbeat -> `worker_controller` -> `membership` -> `reconciliation` -> messages through `channel`.
Lost worker -> `membership` -> `lease_backoff`, `crash_loops` -> `quarantine` -> `scheduling` ->
placements through `channel`.
"""
