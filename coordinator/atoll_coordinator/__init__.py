"""The program that takes jobs, prepares data, leads the search and chooses the model.

- `service`: jobs, workers and the search
- `data`: from measurement files to regression problems
- `model`: from what a search hands on to equations and verdicts
- `stochastic`: steps, paths and densities of processes; `units`, `dimensions`: units of columns and of expressions
- `settings`: every number that was set by hand, by stage, with its reason

It stands above `atoll_core`; the command line and the library for users, `atoll`, stand above it.
"""
