"""How a worker and its coordinator stay connected.

- ``connection``: the handshake, the coordinator's absence, the drain before the worker ends, its exit code.
- ``requests``: the messages and queries that the worker sends, and which of them a reply answers.

`atoll_island_worker.worker` receives the bus's events and hands them to ``connection`` (replies to greetings, lost
links, ``shutdown``) or to the session, whose outgoing actions go through ``requests`` to the bus. A worker that has
been told to end (SIGTERM, its lifetime) drains: its heartbeats say ``leaving``, the coordinator places its islands
elsewhere and answers ``shutdown``; it ends without that when its grace or the coordinator's absence is over.
"""
