"""Searches on noisy data: ``python -m benchmarks.noise``.

``data`` makes the measurements, ``odd_systems`` systems with odd constants, ``judging`` runs and judges
one search, ``tables`` and ``goals`` present many, ``cases`` are single hard cases.
"""
