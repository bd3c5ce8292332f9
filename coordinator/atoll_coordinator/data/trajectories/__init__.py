"""A table with roles of columns -> measurements that can be smoothed: `measurements.take_measurements`.

- `table_checks`: drops incomplete rows, and checks the measured values
- `measurements`: where trajectories begin, their names, centred times, states with unwrapped angles, held-out
  trajectories; trajectories split at gaps in the times
"""
