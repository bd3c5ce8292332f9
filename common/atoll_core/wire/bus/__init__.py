"""The bus: publish, query, presence and timers.

- ``interface``: guarantees for every participant, and legal keys; `tests/contract` checks it on every bus.
- ``zenoh_bus``: the bus over Zenoh, as a router or a client.
- ``queues``: incoming events, timers and outgoing answers of a real bus.
- ``metered_bus``: counts messages and bytes by kind.

The bus of the tests, in virtual time and with faults, is `tests.simulation.bus`.
"""
