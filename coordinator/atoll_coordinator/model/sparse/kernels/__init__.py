"""Compiled loops of sparse regression.

- `elimination`: integrals over windows, least squares, terms left out
- `robust`: rows weighted by what they leave, forward selection
- `corrected`: terms left out where columns have errors whose mean products are known
- `errors_in_variables`: the same where columns have errors, too
"""
