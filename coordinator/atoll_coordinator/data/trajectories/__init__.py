"""From a table with roles of columns to measurements that can be smoothed; the entry point is
`measurements.take_measurements`.

- `table_checks`: drops incomplete rows, and checks the measured values
- `measurements`: where trajectories begin, their names, centred times, states with unwrapped angles, held-out
  trajectories; trajectories split at gaps in the times
"""
