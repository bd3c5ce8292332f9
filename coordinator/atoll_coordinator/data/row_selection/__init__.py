"""Which rows the search is given.

- `selected_rows`: `select_rows`, from the uncertainties of derivatives, and fewer where there are many; weights of rows
  over their mean, and rows of too little weight where left-hand sides are given
- `row_means`: means in place of rows where there are far more than the states' time scales need
- `excluded_rows`: the reason why a row is not used: end, gap, jump or outlier

Estimates go in, `SelectedRows` come out.
"""
