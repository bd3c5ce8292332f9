"""A model as users hold it after it was found.

``core`` has `ModelCore`, a result with names, right-hand sides and constants; `atoll.Model` (``atoll.api.model``) adds
the methods of users.
``equations`` has equations and constants for display, ``vector_field`` the right-hand sides as functions with their
derivatives, ``arguments`` checks arguments of users, ``simulation`` integrates and draws paths of stochastic processes.
"""
