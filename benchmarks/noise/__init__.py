"""Searches on noisy data: ``python -m benchmarks.noise``.

``data`` makes the measurements, ``odd_systems`` systems with odd constants, ``search`` runs one search, ``judging``
judges it, ``tables`` and ``goals`` present many, ``cases`` are single hard cases.
"""
