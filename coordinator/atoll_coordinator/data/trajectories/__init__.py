"""A table with roles of columns -> measurements that can be smoothed: `measurements.take_measurements`.

- `usable_rows`: selects the rows that can be used, and checks the measured values
- `measurements`: where trajectories begin, their names, centred times, states with unwrapped angles, held-out
  trajectories; trajectories split at gaps in the times
"""
