"""Compiled loops of sparse regression.

- `least_squares`: integrals over windows, least squares by orthogonalisation
- `robust`: rows weighted by what they leave
- `elimination`: terms left out one after another, also where columns have errors whose mean products are known
- `errors_in_variables`: fits where columns have errors, too
"""
