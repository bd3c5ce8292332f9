"""What is said of the selected model.

- `conclusion`: the model fitted to all rows, rounded, simulated and judged: `summarize`
- `group_constants`: the same where groups of trajectories have constants of their own: `summarize_groups`
- `shared_terms`: terms that equations share, fitted together
- `standard_errors`: standard errors, intervals and correlations of constants
- `trajectory_simulation`: the model along measured trajectories, with bands
- `attractor`: whether a long simulation of a chaotic model keeps the measured averages
- `prediction`: whether model and rivals foretell the same from other initial states
- `residuals`: whether what a simulation leaves is as large as the noise, and without a pattern
- `random_walk`: whether it grows like a random walk, so that noise is part of the law
- `quadratic_forms`: how large it may be by chance
- `verdict`: the grade of an equation, and the reason in one sentence

A `SelectedModel` goes in, a `Refinement` comes out.
"""
