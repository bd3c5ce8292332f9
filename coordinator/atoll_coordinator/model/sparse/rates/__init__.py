"""Laws by regression on estimated derivatives, each row by its own standard error: for many variables.

- `rate_rows`: derivatives, their errors and the variables on all rows that were measured
- `screening`: which variables an equation takes
- `rate_sums`: sums of products and functions fitted robustly, the shortest of them
- `functions`: which product with a function a polynomial lacks
- `networks`: a hyperbolic tangent of a weighted sum beside a linear part
- `rate_laws`: the law of one state, if its rows have one

The reasons and figures: ADR 0043.
"""
