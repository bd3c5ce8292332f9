"""Stochastic processes dx = f dt + g dW: what a step of one moves, and paths of it.

- `discretisation`: what a step is
- `moments`: mean and covariance of a step
- `paths`: paths drawn with these moments, and ensembles of them
- `densities`: the density that paths settle into

The reasons and figures: ADR 0044.
"""
