"""The equation of one variable, fitted to its target without simulations.

- `equation`: from a front to the equation that is shown: `Shortening`, `fit_equation`
- `fit`: the `Fitter` of constants to the rows of a target
- `covariance`: the covariance of fitted constants, their standard errors and intervals
- `rounding`: fitted constants made simple numbers; systems and processes use it as well
- `errors`: loss and mean squared error of a program
"""
