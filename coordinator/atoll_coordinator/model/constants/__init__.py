"""Errors and rounding of fitted constants, for all fits: to a target, to trajectories, to the steps of a process.

- `standard_errors`: from normal equations to covariances, standard errors, intervals and correlations
- `rounding`: replaces constants by simple numbers if the data support these numbers; rounds the other estimates to few
  digits
"""
