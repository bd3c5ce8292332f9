"""What this process may use of its machine (`cores`, `folders`, `linear_algebra`), and what it takes of it (`usage`).

Nothing here knows anything else of `atoll` but its errors.
"""
