"""Compiled loops of sparse regression.

- `elimination`: integrals over windows, least squares, terms left out
- `robust`: rows weighted by what they leave, forward selection
- `errors_in_variables`: the same where columns have errors, too
"""
