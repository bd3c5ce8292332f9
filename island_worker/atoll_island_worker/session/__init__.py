"""What a worker computes, sends and answers next: a pure state machine, without clock, thread or I/O.

- ``events``, ``actions``: what goes in and what comes out; ``epoch_tasks``: how islands' epochs are named.
- ``worker_session``: all of the worker; one ``shard`` for each archipelago that is placed here under a term.
- ``local_island``: the states of one island, and when it asks for what it waits for.
- ``retransmit_buffer``: emigrants, reports and snapshots, kept for those who ask again.
- ``state_transfer``: the states with which a term begins; ``mail``: the mailbox, and what came before its placement.

The life of an epoch: a shard's island is ready, a `RunTask` computes it, its report waits until all islands here have
reported, its emigrants go to the shards of other workers (`Send`) or into the mailbox here. A migrant that arrives is
filed by (epoch, destination, source); when those of all senders are there, the island is ready again. What is missing
is pulled from the sender's retransmit buffer.
"""
