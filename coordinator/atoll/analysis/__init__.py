"""The dynamics of a model: pure functions of a vector field and a box of states.

``analyse`` computes an `Analysis`. ``analysis`` defines this class, with its sentences, text and plain data. All other
modules use ``flow``: ``fixed_points``, ``nullclines``, ``limit_cycles``, ``lyapunov``, ``basins``, ``conserved``
(conserved quantities), and ``dynamics``, which compares the model with the data. When a parameter varies,
``continuation`` follows fixed points and ``cycle_continuation`` follows limit cycles.
"""
