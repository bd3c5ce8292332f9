"""From a table with roles of columns to measurements that can be smoothed; the entry point is
`measurements.take_measurements`.

- `usable_rows`: selects the rows that can be used, and checks the measured values
- `measurements`: where trajectories begin, their names, centred times, states with unwrapped angles, held-out
  trajectories; trajectories split at gaps in the times
"""
