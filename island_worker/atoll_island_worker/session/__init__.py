"""Decides what a worker computes, sends and answers next: a pure state machine, without clock, thread or I/O.

- ``interface``: events in, actions out, and the keys of shards and epochs.
- ``worker_session``: the whole worker; one ``shard`` for each archipelago that is placed here under a term.
- ``kept_messages``: emigrants, reports and snapshots that other programs request.

The course of an epoch: when an island of a shard is ready, a `RunTask` computes it, and the emigrants of other workers
are requested (`SendPull`). Its report waits until all islands here have reported. Its emigrants go to islands here, or
answer the pulls of other workers (`Respond`). An arriving migrant is stored by epoch and source. When the migrants of
all senders have arrived, the island is ready again.
"""
