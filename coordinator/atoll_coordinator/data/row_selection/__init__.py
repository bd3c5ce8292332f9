"""Which rows the search is given.

- `selected_rows`: `select_rows`, from the uncertainties of derivatives
- `thinning`: fewer rows where there are many
- `excluded_rows`: the reason why a row is not used: end, gap, jump or outlier
- `weights`: weights of rows over their mean, and rows of too little weight where left-hand sides are given

Estimates go in, `SelectedRows` come out.
"""
