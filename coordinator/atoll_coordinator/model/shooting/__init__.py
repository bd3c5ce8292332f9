"""Systems of equations fitted to measured trajectories by multiple shooting.

- `multiple_shooting`: the fit of constants and initial states; its docstring explains how the modules work together
- `measurements`: the recording as arrays for fits: all rows one after another, and the pieces that are simulated
- `system`: several programs as one system whose constants can be fitted; `composed_system`: the same for equations that
  were composed with a template
- `many_starts`: fits of given forms from many starts, with growing horizons; also for hidden states
- `integration`: states and sensitivities along segments; `kernels`: compiled parts of integration and of a fit's steps
- `error_model`: correlated errors of neighbouring rows; `smoothing_noise`: the size of errors of measurement before a
  law is known; `residual_noise`: their size from the residuals of a law
- `fit_result`: a fitted system (`TrajectoryFit`), the covariance of its constants, the growth of its errors
- `points_between`: points away from the measured curves, each computed from two measured points
- `warmup`: compiles or loads the kernels

A recording and programs go in, a `TrajectoryFit` comes out, with simulated states, residuals and normal equations.
"""
