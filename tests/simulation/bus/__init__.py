"""A bus in memory and in virtual time, with faults from a seeded plan; `tests/contract` checks that it is a bus.

- ``network``: the router in the middle, the clock, and the list of what will happen.
- ``participant``: one participant's bus (`atoll_core.wire.bus.interface.Bus`), its own time, and what waits for it.
- ``matching``: which keys an expression matches.
- ``fault_plan``: the plan of losses, delays, partitions and crashes.
"""
