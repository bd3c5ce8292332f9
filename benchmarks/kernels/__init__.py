"""Speed of the kernels: ``python -m benchmarks.kernels``.

``corpus`` loads the operation lists. ``loops`` has the loops that are timed, and ``speeds`` times them. ``elementary``
measures accuracy and speed of sin, cos, exp, log, tanh and pow. ``searches`` measures whole searches in one process.
"""
