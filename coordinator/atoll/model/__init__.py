"""A model as users hold it after it was found.

``model`` has the class `atoll.Model`, made of a result; ``shortcuts`` its methods that use other packages.
``equations`` has equations and constants for display, ``vector_field`` the right-hand sides as functions with their
derivatives, ``arguments`` checks arguments of users, ``simulation`` integrates and draws paths of stochastic processes.
"""
