"""Refining: from the programs of a search to the displayed equations and their verdicts.

`pipeline` has an overview of all steps. The packages, in the order in which `pipeline` uses them:

- `pools`: the input of refining (the `Pool` of each variable, laws); `refinement`: its result (`Refinement`)
- `description_length`: the three description lengths and their prices
- `batches`: named pure functions; any worker may compute a batch of their items (`BatchFunction`, `Batches`, `Spread`)
- `deadline`: the end set by ``--max-time``
- `thinning`: subsets of many rows
- `least_squares`, `cholesky`: the Levenberg-Marquardt loop of every fit, and the linear equations of its steps
- `structure`: algebra without data: changes of a program at one node, units of constants, poles
- `regression`: the equation of one variable fitted to its target
- `sparse`: laws of one variable as sparse sums of products, by regression alone
- `template`: first estimates of the parameters of given equations, and the targets of their unknown parts
- `hidden`: the course of hidden states without given equations, by proposals and laws in turns
- `shooting`: a system of equations fitted to the measured trajectories
- `selection`: which equations together are the model, and their closest alternatives
- `inference`: the errors of constants, simulations, checks of residuals, the verdict
- `result`: ``result.json``, and its text

An import contract in pyproject.toml lists the imports that are allowed between these packages.
"""
