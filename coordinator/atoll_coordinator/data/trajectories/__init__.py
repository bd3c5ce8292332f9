"""From a table whose columns have roles to measurements that can be smoothed: `measurements.take_measurements`.

- `checks`: which rows are used, and all checks of the measurements
- `measurements`: where trajectories begin, their names, centred times and states, full turns taken out of angles, which
  are held out; trajectories split at gaps in the times
"""
