"""What the data leave open, and which experiment settles it: coverage of intervals, experiments until the truth wins.

``python -m benchmarks.experiments.coverage`` and ``python -m benchmarks.experiments.respiration``; ``results`` makes
results of simulated measurements without a search.
"""
