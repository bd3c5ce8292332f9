"""Laws as sparse sums, found by regression alone: no simulation, no population, seconds at most.

- `atoms`: the dictionary of terms: products of variables, these times functions, libraries of both
- `rows`: builders of rows: derivatives, integrals over windows, with the covariance of their errors
- `regression`: the engine: fits, elimination, the criterion; its essay says how it works
- `laws`: which rows and libraries an equation has, which sum is its law, and which variables it takes
- `many_variables`: laws with functions where variables are many, on derivatives or short windows
- `pursuit`: sums of a polynomial and of products with functions, as candidates for trajectories (matching pursuit)
- `kernels`: least squares and elimination, compiled; `warmup` makes them ready

`selection` judges them by trajectories. The reasons and figures: ADR 0036, 0041, 0043, 0048 and 0095.
"""
