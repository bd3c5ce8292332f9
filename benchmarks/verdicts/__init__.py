"""Tables drawn at random on which verdicts can be false: ``python -m benchmarks.verdicts``.

`few_rows`, `targets`, `groups`, `inputs` and `autonomous` draw a table from a seed; `laws` has what some of them draw
from, `simulation` solves laws and models and says how well the data determine a constant; `drawn` is one table and what
is true of it; `judging` judges a result, `campaign` runs the jobs, `tables` sums them up. `cases` runs a folder of
tables whose right verdicts are known.
"""
