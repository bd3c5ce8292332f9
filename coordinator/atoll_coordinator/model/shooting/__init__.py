"""Systems of equations fitted to measured trajectories by multiple shooting.

- `measurements`: the recording laid out for fits: all rows one after another, and the pieces that are simulated
- `system`: several programs as one system whose constants can be fitted
- `multiple_shooting`: the estimator of constants and initial states; `fit_cache` remembers fits
- `segment_batches`: segments of one fit as they travel to other machines and back
- `trajectory_fit`: what it returns
- `error_growth`: how fast errors grow along a fitted system
- `error_model`: errors that go together, as fits weigh them; `variance`: errors that grow with the value;
  `independence`: how many independent numbers trajectories hold
- `covariance`: how well a fit determines its constants
- `points_between`: points beside measured curves, from two measured ones
- `kernels`: integration, sensitivities and normal equations, compiled; `warmup` makes them ready

A recording and programs go in, a `TrajectoryFit` comes out: states as simulated, residuals, normal equations.
"""
