"""From the programs of a search to the equations that are shown, and how far they can be trusted.

`pipeline` tells the whole way on one page; it goes down this list from refinement to result:

- `pools`: the input of refining (the `Pool` of each variable, laws); `refinement`: its result (`Refinement`)
- `description_length`: the three description lengths and their prices
- `batches`: named pure functions of which any machine may compute batches (`BatchFunction`, `Batches`, `Spread`)
- `deadline`: the end set by ``--max-time``
- `thinning`: subsets of many rows
- `least_squares`, `cholesky`: the driver of every fit by damped steps, and its linear equations
- `structure`: programs rewritten or changed in one place. Algebra without data
- `regression`: the equation of one variable fitted to its target
- `sparse`: laws of one variable as sparse sums of products, by regression alone
- `shooting`: a system of equations fitted to the measured trajectories
- `selection`: which equations together are the model, and which come next
- `inference`: errors of constants, simulations, residuals, the verdict
- `result`: ``result.json``, and its text

Which room may import which is a contract in pyproject.toml.
"""
