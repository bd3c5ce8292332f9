"""From what a search hands on to the equations that are shown, and how far they can be trusted.

`pipeline` tells the whole way on one page; it goes down this list from refinement to result:

- `pools`: what refining is given (the `Pool` of each variable, laws); `refinement`: what it gives (`Refinement`)
- `criteria`: the description lengths, side by side
- `batches`: named pure functions of which any machine may compute batches (`BatchFunction`, `Batches`, `Spread`)
- `deadline`: the end that ``--max-time`` sets
- `thinning`: which of many rows stand for all
- `least_squares`, `cholesky`: the driver of every fit by damped steps, and its linear equations
- `structure`: programs rewritten, changed in one place, made of libraries of terms. Algebra without data
- `regression`: the equation of one variable fitted to its target
- `sparse`: laws of one variable as sparse sums of products, by regression alone
- `shooting`: a system of equations fitted to the measured trajectories
- `selection`: which equations together are the model, and which come next
- `inference`: errors of constants, simulations, residuals, the verdict
- `result`: ``result.json``, and its text for people

Which room may import which is a contract in pyproject.toml.
"""
