"""Chaotic flows of the ``dysts`` package (Gilpin 2021): their equations from noisy trajectories, form not given.

- `making`: trajectories and true equations as NPZ files, from ``dysts``; nothing else here needs that package
- `flows`: those files read; noise; the table of a search
- `judging`: the error of the coefficients, the form, the verdict of one search
- `campaign`: all searches that are asked for, one after another
- `tables`: what is printed, beside published errors
"""
