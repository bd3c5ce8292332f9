"""The compiled part of the search; `atoll_core.compilation.jit` has the rules for kernels.

- ``variation``: random lists, crossover, mutation. ``tape``: the live nodes of a list, and its canonical program.
- ``measured_rows``: the rows on which individuals are measured. ``fit``: fits of coefficients and constants; the loss.
- ``generation``: whole generations with deterministic crowding. ``offers``: individuals to be measured on all rows.
- ``predictors``: quality and variation of predictors. ``trainers``: losses of trainers. ``random``: random numbers.

A generation uses ``variation``, ``tape`` and ``fit``. Every edit of these files changes the fingerprint of all workers.
"""
