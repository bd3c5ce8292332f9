"""Decides what a worker computes, sends and answers next: a pure state machine, without clock, thread or I/O.

- ``interface``: events in, actions out, and the keys of shards and epochs.
- ``worker_session``: the whole worker; one ``shard`` for each archipelago that is placed here under a term.
- ``kept_messages``: mail that has arrived; emigrants, reports and snapshots that others may ask for again.

The life of an epoch: an island of a shard is ready, a `RunTask` computes it, its report waits until all islands here
have reported, and its emigrants go to the shards of other workers (`Send`) or into the mailbox here. A migrant that
arrives is filed by (epoch, destination, source). When the migrants of all senders are there, the island is ready again.
Missing migrants are pulled from the retransmit buffer of the sender.
"""
