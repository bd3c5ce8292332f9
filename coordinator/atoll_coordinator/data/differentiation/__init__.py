"""Values, derivatives and their uncertainties, one state at a time: `Measurements` -> one `StateEstimate` for each.

- `derivatives`: `estimate_states`: whether a state is smoothed or interpolated, and its estimate; `warm_up`
- `smoothing`: loess, its span, degree and thinning selected by cross-validation; robust loess; noise by residuals
- `interpolation`: derivatives of data without noise, missing values, noise by predicted rows
- `quantisation`: the steps in which values were recorded, and the least errors that follow
- `inputs`: the curve of an input between rows, for fits, simulations and exports
- `held_inputs`: states under inputs that are held between rows, whose slopes jump
- `kernels`: compiled loops of loess and of interpolation
"""
