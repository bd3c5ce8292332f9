"""The dynamics of a model: pure functions of a vector field and a box of states.

``analysis`` gathers all of it; ``sentences`` are what is said of it, in a report as well, and ``rendering`` writes it
as text and as ``plain_data``. ``box`` and ``flow`` are what the rest stands on: ``fixed_points`` by ``newton`` steps,
with their ``stability``, and ``fixed_sets``, curves and surfaces of them; ``nullclines``, ``limit_cycles``,
``lyapunov``, ``basins``, ``conserved`` quantities, and ``dynamics``, the model beside the data. Along a
``continuation_parameter``, ``continuation`` follows fixed points and ``cycle_continuation`` limit cycles, both by
``path_following``; a ``cycle_curve`` is what is followed of the latter, solved for by ``collocation``.
"""
