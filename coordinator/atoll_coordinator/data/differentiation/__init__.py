"""Values, derivatives and their uncertainties, one state at a time: `derivatives.estimate_states`.

- `derivatives`: whether a state is smoothed or interpolated, and its `StateEstimate`
- `smoothing`: loess, its span, degree and thinning selected by cross-validation
- `robust`: weights that take outliers out of loess
- `interpolation`: derivatives of data without noise
- `noise`: the noise estimated, from what loess leaves or from predicted rows
- `quantisation`: the steps in which values were recorded, the least errors that they can have
- `missing_values`: a state at rows where it was not measured
- `inputs`: the curve of an input between rows, for fits, simulations and exports
- `held_inputs`: states under inputs that are held between rows, whose slopes jump
- `value_scale`: the scale by which values are judged
- `kernels`: compiled loops of loess and of interpolation; `warmup` compiles or loads them

`Measurements` go in, estimates come out: signals -> smoother -> smoothed signals -> estimate.
"""
