"""From measurement files to a `Table`, on the client's side; `files` is the whole way on one page.

- `text`, `arrays`, `typed_formats`: formats -> `RawTable` of cells; `matlab_child` is a process for one of them
- `raw_table`: header, row of units, footer; `reshaping`: tables of other shapes -> a row for each time
- `cells`, `dates`: cells -> numbers and dates

Nothing is interpreted beyond numbers, dates, units, and where trajectories begin; `Table.read_as` says how.
"""
