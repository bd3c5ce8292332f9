"""From a table with roles of columns to measurements that can be smoothed; the entry point is
`measurements.take_measurements`.

- `table_checks`: drops incomplete rows, and checks the measured values
- `measurements`: divides rows into trajectories, names them, centres the times, unwraps angles, selects held-out
  trajectories, and splits trajectories at gaps in the times
"""
