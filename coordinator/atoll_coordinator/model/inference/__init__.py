"""Inference on the selected model: a `SelectedModel` goes in, a `Refinement` comes out.

- `conclusion`: read this module first: `conclude` calls the functions of the modules below, in this order
- `final_model`: the equations as they are shown: fitted to all rows, rounded, simulated along whole trajectories
- `groups`: which constants groups of trajectories share; `shared_terms`: terms that equations share, fitted together
- `run_values`: the values of parameters that differ by run
- `trajectory_simulation`: the model along measured trajectories, with bands
- `long_run`: whether whole trajectories are described, and whether a chaotic model keeps the measured averages
- `prediction`: whether the model and its alternatives predict the same from other initial states
- `verdict`: the table of checks, and the grade that follows from it
- `checks`: the quantity, the limit and the clause of each check. `trajectory_checks` (for simulated equations) and
  `target_checks` (for the rows of a target) compute the quantities, and add further checks
- `residuals`: tests of the size and of the pattern of residuals
- `quadratic_forms`: probabilities of ratios of variances, for the tests
- `residual_covariance`: the covariance of residuals if there are few rows; and how much standard errors increase
  because few rows cannot exclude a correlation of the measurement errors
- `null_models`: evidence for an equation against a constant and a random walk
- `remarks`: warnings about a pattern of residuals: process noise, differences between trajectories, forcing, hidden
  states
"""
