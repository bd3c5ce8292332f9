"""Which rows the search is given: estimates -> `SelectedRows`.

- `selected_rows`: rows of certain derivatives, fewer where there are many, why others are excluded; weights of rows
- `row_means`: means in place of rows where there are far more than the states' time scales need
"""
