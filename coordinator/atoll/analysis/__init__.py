"""The dynamics of a model: pure functions of a vector field and a box of states.

``analyse`` computes an `Analysis`, which ``analysis`` holds and writes as sentences, text and plain data. The others
stand on ``flow``: ``fixed_points``, ``nullclines``, ``limit_cycles``, ``lyapunov``, ``basins``, ``conserved``
quantities, and ``dynamics``, the model compared with the data. ``continuation`` follows fixed points as a parameter
varies, ``cycle_continuation`` limit cycles.
"""
