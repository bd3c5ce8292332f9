"""From a table whose columns have roles to measurements that can be smoothed: `measurements.take_measurements`.

- `checks`: which rows are used, and every objection to what was measured
- `trajectories`: where trajectories begin, their names, centred times and states, full turns taken out of angles;
  `select_held_out`: which of them are kept from the search
- `gaps`: trajectories split where the times leave more room than is smoothed at a time

Tables and roles go in, `Measurements` come out; `gaps` makes new ones from old ones.
"""
