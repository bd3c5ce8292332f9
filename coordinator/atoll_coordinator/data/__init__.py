"""From measurement files to the regression problems of a job. `prepare` calls all stages in order:

- `reading`: files -> `Table`, on the client's side
- `roles`: column names and options -> `Roles`, symbols of expressions
- `templates`, `template_units`: given equations with parameters and unknown parts, and their units
- `prior_knowledge`: guesses, known and given equations and bounds, checked and resolved against the roles
- `trajectories`: `Table` and `Roles` -> `Measurements`: rows, trajectories, times, states, split at gaps
- `columns`: checks of the columns before anything is searched
- `differentiation`: `Measurements` -> one `StateEstimate` for each state: values, derivatives, uncertainties
- `row_means`: oversampled rows -> means
- `searched_rows`: estimates -> `SelectedRows`, with reasons for excluded rows
- `increments`: `Measurements` of a stochastic process -> `Preparation`, without smoothing
- `recording`: all of these as a `Preparation`: the dataset of the search and the recording
- `outline`: text for users before a job: how the table was read, and the equations of a search

A stage uses only results of the stages above it. A contract in pyproject.toml lists the imports that are allowed
between stages.
"""
