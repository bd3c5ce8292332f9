"""The equation of one variable, fitted to its target without simulations.

- `equation`: from a front to the equation that is shown, and the errors of its constants
- `shortening`: from candidates to the shortest description near them; processes use it as well
- `fit`: the `Fitter` of constants to the rows of a target
- `errors`: loss and mean squared error of a program
"""
