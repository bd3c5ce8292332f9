"""From measurement files to a `Table`, on the client's side. `files` tells the whole way:

- `encodings`, `layout`: bytes -> text -> `RawTable` of cells: separators, comments, header, row of units
- `parquet`, `workbooks`, `arrays`, `matlab`, `hdf5`, `records`: other formats -> `RawTable`
- `preamble`, `header`, `footer`: where the table begins in rows of text and of workbooks, what its columns are called,
  and where it ends
- `times_as_columns`, `calendar_columns`, `long_tables`: `RawTable` -> one with a row for each time
- `columns`: `RawTable` -> columns of numbers and of dates: `numerals`, `date_columns`, `dates`
- `empty_columns`, `even_times`: what of the joined table is left out, and times that only options tell
- `dates` also counts dates in one unit over all files, once these are joined

Nothing is interpreted beyond numbers, dates, units, and where trajectories begin; `Table.read_as` says how.
"""
