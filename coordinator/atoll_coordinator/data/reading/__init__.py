"""From measurement files to a `Table`, on the client's side. `files` tells the whole way:

- `encodings`, `layout`: bytes -> text -> `Rows` of cells: separators, comments, header, row of units
- `parquet`, `workbooks`, `arrays`, `matlab`, `hdf5`, `records`: other formats -> `Rows`
- `columns`: `Rows` -> columns of numbers and of instants, by `numerals` and `instants`
- `instants` -> times in one unit over all files, once these are joined

Nothing is interpreted beyond numbers, dates, units, and where trajectories begin; `Table.read_as` says how.
"""
