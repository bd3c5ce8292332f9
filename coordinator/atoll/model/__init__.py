"""The model that a job has found.

``core`` has `ModelCore`: a result with its names, right-hand sides and constants. `atoll.Model` (``atoll.api.model``)
adds the public methods. ``equations`` has equations and constants for display, ``given_sides`` the sides that
the user gave in part. ``vector_field`` has the right-hand sides as functions, with their derivatives. ``arguments``
checks the arguments of users. ``simulation`` integrates the model and draws paths of stochastic processes.
"""
