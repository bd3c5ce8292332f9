"""Checks of columns before a search. A client can run them, since nothing is smoothed or compiled.

- `examined_columns`: `ColumnFinding`, a sentence with advice; `ExaminedColumns`, the input of a check; sums in a fixed
  order, so that every machine leaves out the same columns
- `values`, `motion`: the checks
- `examination`: `examine` runs all checks in order and acts on their findings if this is safe
"""
