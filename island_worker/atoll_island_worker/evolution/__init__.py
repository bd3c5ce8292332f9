"""The search of one island: a population of operation lists, its predictors and its front. Pure but for scratch arrays.

- ``island``: the life of an island, epoch by epoch; ``setup``: what does not change during it.
- ``structures``: the arrays that kernels work on. ``kernels``: generations, fits, predictors, offers, compiled.
- ``coevolution``: solutions, predictors and trainers in turn. ``migration``: who sends which solutions where.
- ``front``: the least error for each size, and how individuals get there; ``runners_up``: the next best beside it.
- ``restricted``: what would enter the front, kept to bounds on constants and required variables.
- ``formula``: programs with their coefficients, worked in or not. ``guesses``: prior knowledge.

Rows come in with ``setup``; an epoch advances the population in ``kernels``, offers the best of each size to the front
after each slice, and ends with a report and, packed by ``migration``, the emigrants.
"""
