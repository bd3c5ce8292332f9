"""How fast the kernels are: ``python -m benchmarks.kernels``.

``corpus`` holds the operation lists that are timed, ``loops`` the timed loops, ``speeds`` the measuring;
``elementary`` measures accuracy and speed of sin, cos, exp, log, tanh and pow.
"""
