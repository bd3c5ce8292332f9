"""From measurement files to a `Table`, on the client's side.

`files` reads CSV and TSV line by line, Parquet by polars and NPZ by numpy, turns cells into numbers and joins files.
Nothing is interpreted beyond numbers, units in headers, and where trajectories begin.
"""
