"""From measurement files to the regression problems of a job. `prepare` is the whole way on one page:

- `reading`: files -> `Table`, on the client's side
- `roles`: column names and options -> `Roles`, symbols of expressions
- `prior_knowledge`: guesses, known equations and bounds, checked and resolved against the roles
- `trajectories`: `Table` and `Roles` -> `Measurements`: rows, trajectories, times, states, split at gaps
- `columns`: checks of the columns before anything is searched
- `differentiation`: `Measurements` -> one `StateEstimate` for each state: values, derivatives, uncertainties
- `selected_rows`: estimates -> `SelectedRows`, and why others are excluded; means where rows are far more than needed
- `increments`: `Measurements` of a stochastic process -> `Preparation`, without smoothing
- `recording`: all of these as a `Preparation`: the dataset of the search and the recording
- `outline`: text for users before a job: how the table was read, and the equations of a search

Data go down this list. Which stage may import which is a contract in pyproject.toml.
"""
