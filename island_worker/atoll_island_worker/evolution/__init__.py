"""The search of one island: a population of operation lists, its predictors and its front. Pure except scratch arrays.

- ``island``: the life of an island, epoch by epoch; guesses; solutions, predictors and trainers in turn.
- ``setup``: problem and settings, which stay constant. ``structures``: the arrays that kernels work on.
- ``kernels``: generations, fits, predictors, offers; compiled.
- ``front``: the least error for each size, how individuals get there, and the runners-up.
- ``migration``: which solutions go to which island.
"""
