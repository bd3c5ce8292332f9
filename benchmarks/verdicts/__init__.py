"""Tables drawn at random on which verdicts can be false: ``python -m benchmarks.verdicts``.

`few_rows`, `targets`, `groups`, `inputs`, `limits`, `rates` and `strong_noise` draw a table from a seed; `motion` has
the laws that they draw from, their solutions, and whether the data identify a constant; `drawn` is one table and what
is true of it; `judging` judges a result, `campaign` runs the jobs, `tables` sums them up. `cases` runs a folder of
tables for which the right verdicts are known.
"""
