"""Inference on the selected model: a `SelectedModel` goes in, a `Refinement` comes out.

- `conclusion`: the way through this list, on one page: `conclude`
- `final_model`: the equations as they are shown, fitted to all rows, rounded, simulated in whole
- `groups`: which constants groups of trajectories share; `shared_terms`: terms that equations share, fitted together
- `trajectory_simulation`: the model along measured trajectories, with bands
- `long_run`: whether whole trajectories are described, and whether a chaotic model keeps the measured averages
- `prediction`: whether the model and its alternatives predict the same from other initial states
- `verdict`: the table of checks, and the grade that follows from it
- `checks`: quantity, limit and clause of each check; further checks, and where quantities come from, in
  `trajectory_checks` for a simulated equation, in `target_checks` for the rows of a target
- `residuals`: whether residuals are as large as the noise, and without a pattern; `quadratic_forms`: how large they may
  be by chance; `residual_covariance`: their covariance in few rows, and how much larger standard errors are if these
  rows do not show whether errors are correlated; `null_models`: comparison with having no equation
- `remarks`: warnings about the pattern of residuals: noise of the process, runs, a forcing, a hidden state
"""
