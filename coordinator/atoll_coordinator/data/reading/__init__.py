"""Reads measurement files into a `Table`, on the client's side; `files` calls the other modules in order.

- `text`, `arrays`, `typed_formats`: formats -> `RawTable` of cells; `matlab_child` is a separate process for MATLAB
  files
- `raw_table`: header, row of units, footer; `reshaping`: tables of other shapes -> a row for each time
- `cells`, `dates`: cells -> numbers and dates

Only numbers, dates, units and the beginnings of trajectories are interpreted; `Table.read_as` says how.
"""
