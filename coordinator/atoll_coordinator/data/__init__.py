"""From measurement files to the regression problems of a job. `prepare` tells the whole way, stage by stage:

- `reading`: files -> `Table`, on the client's side; `table_summary`: what a table holds, in lines for a person
- `outline`: what a job would search in it
- `roles`: column names and options -> `Roles`, symbols of expressions, left-hand sides
- `prior_knowledge`: guesses and known equations, checked and resolved against the roles
- `trajectories`: `Table` and `Roles` -> `Measurements`: rows, trajectories, times, states, split at gaps
- `differentiation`: `Measurements` -> one `StateEstimate` for each state: values, derivatives, uncertainties
- `row_selection`: estimates -> `SelectedRows`, and why others are excluded
- `increments`: `Measurements` of a stochastic process -> `Preparation`, without smoothing
- `assembly`: all of these -> `Preparation`, which `recording` defines: the dataset of the search and the recording

Data go down this list. Which stage may import which is a contract in pyproject.toml.
"""
