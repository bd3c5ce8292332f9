"""The bus: publish, query, presence and timers, whatever carries the messages.

- ``interface``: what every participant may rely on, and legal keys; `tests/contract` checks it on every bus.
- ``zenoh_bus``: the bus over Zenoh, as a router or a client. The only module that imports zenoh.
- ``inbox``: events and timers that wait for the owner thread.
- ``turns``: things that wait, of parties that take turns.
- ``outbox``: answers that wait for a thread that sends them.
- ``lingering``: sockets of a router, which are closed without a wait.
- ``metered_bus``: counts what goes through a bus, by kind.

Events come from Zenoh's threads into the ``inbox``; the owner's loop takes them by `Bus.receive`. The bus in virtual
time, with faults, by which the service is tested without a network, is `tests.simulation.bus`.
"""
