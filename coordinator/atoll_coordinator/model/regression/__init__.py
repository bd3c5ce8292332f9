"""The equation of one variable, fitted to its target without simulating anything.

- `equation`: from a front to the equation that is shown: `fit_equation`
- `shortening`: members of the front reduced, changed and compared by description length
- `fit`: constants fitted to all rows by Levenberg's and Marquardt's method
- `covariance`: the covariance of fitted constants, their intervals, and what they cost
- `rounding`: fitted constants made simple numbers; `simple_numbers`: which there are, and their lengths
- `errors`: loss and mean squared error of a program

Programs go in, fitted programs come out: `equation` -> `shortening` -> `rounding` -> `covariance` -> `fit`.
"""
