"""Errors and rounding of fitted constants, for all fits: to a target, to trajectories, to the steps of a process.

- `standard_errors`: from normal equations to covariances, standard errors, intervals and correlations
- `rounding`: simple numbers where the data single them out, else estimates with few digits
"""
