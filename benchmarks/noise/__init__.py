"""Searches on noisy data: ``python -m benchmarks.noise``.

``data`` makes the measurements, ``judging`` runs and judges one search, ``tables`` presents many.
"""
