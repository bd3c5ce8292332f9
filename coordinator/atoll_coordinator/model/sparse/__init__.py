"""Sparse regression: finds laws that are sums of few terms. It needs no simulations and no population, and takes
seconds at most.

- `atoms`: the dictionary of terms (products of variables, and products with functions), and libraries of terms
- `rows`: builders of rows: derivatives, integrals over windows, with the covariance of their errors
- `regression`: fits, elimination and the criterion; its docstring explains how they work
- `laws`: chooses the rows, the libraries and the variables for each equation, and the sum that is the law
- `many_variables`: laws with functions if there are many variables, fitted to derivatives or short windows
- `pursuit`: sums of a polynomial and of products with functions, as candidates for trajectories (matching pursuit)
- `kernels`: least squares and elimination, compiled; `warmup` compiles or loads them

`selection` then compares the laws by trajectories. Reasons and figures: ADR 0036, 0041, 0043, 0048 and 0095.
"""
