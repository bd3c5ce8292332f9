"""The equation of one variable, fitted to its target without simulations.

- `equation`: `refine_equation` chooses the equation that is shown, and the errors of its constants
- `shortening`: `Shortening` finds the shortest descriptions among candidates and similar programs; the choice of a
  process also uses it
- `fit`: `LeastSquares` fits constants to the rows of a target
- `errors`: `measure_errors` returns loss and mean squared error of a program
"""
