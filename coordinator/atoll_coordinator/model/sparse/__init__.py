"""Sparse regression: laws as sums of few terms, without simulations or a population, in seconds at most.

- `atoms`: the dictionary of terms (products of variables, and products with functions), and libraries of terms
- `rows`: builders of rows: derivatives, integrals over windows, with the covariance of their errors
- `regression`: the engine: fits, elimination, the criterion; its docstring explains how it works
- `laws`: the rows and libraries for each equation, the sum that is the law, and the choice of variables
- `many_variables`: laws with functions if there are many variables, fitted to derivatives or short windows
- `pursuit`: sums of a polynomial and of products with functions, as candidates for trajectories (matching pursuit)
- `kernels`: least squares and elimination, compiled; `warmup` compiles or loads them

`selection` then compares the laws by trajectories. Reasons and figures: ADR 0036, 0041, 0043, 0048 and 0095.
"""
