"""Values, derivatives and their uncertainties: the input is `Measurements`, the output one `StateEstimate` for each
state.

- `derivatives`: `estimate_states` decides whether a state is smoothed or interpolated, and estimates its values;
  `warm_up` compiles the kernels
- `smoothing`: loess, with span, degree and thinning selected by cross-validation; robust loess; an estimate of the
  noise from residuals
- `interpolation`: derivatives of data without noise; missing values; an estimate of the noise from errors of predicted
  rows
- `quantisation`: the steps in which values were recorded, and the least errors that follow from them
- `inputs`: the curve of an input between rows, for fits, simulations and exports
- `held_inputs`: states under inputs that are held between rows, whose slopes jump
- `kernels`: compiled loops of loess and of interpolation
"""
