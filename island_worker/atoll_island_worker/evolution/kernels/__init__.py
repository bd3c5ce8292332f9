"""The compiled part of the search; see `atoll_core.compilation.jit` for what a kernel may do.

- ``variation``: random lists, crossover, mutation. ``tape``: from a list to its live nodes, and to a canonical program.
- ``measured_rows``: the rows of measurements. ``fit``: coefficients and constants fitted to rows; the loss.
- ``generation``: whole generations with deterministic crowding. ``offers``: which individuals are measured on all rows.
- ``predictors``: predictors judged and varied. ``trainers``: trainers measured. ``random``: the counter-based stream.

A generation goes through ``variation``, ``tape`` and ``fit``; every edit here changes the fingerprint of all workers.
"""
