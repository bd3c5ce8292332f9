"""The program that takes jobs, prepares data, leads the search and chooses the model.

- `cli`: the command line; `client`: what it asks a coordinator
- `service`: jobs, workers and the search
- `data`: from measurement files to regression problems
- `model`: from what a search hands on to equations and verdicts
- `settings`: every number that was set by hand, by stage, with its reason
"""
