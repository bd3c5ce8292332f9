"""The search of one island: a population of operation lists, its predictors and its front. Pure except scratch arrays.

- ``island``: the epochs of an island; guesses; the evolution of solutions, predictors and trainers in turn.
- ``setup``: problem and settings, which stay constant. ``structures``: the arrays that kernels work on.
- ``kernels``: generations, fits, predictors, offers; compiled.
- ``front``: the least error for each complexity, how individuals enter the front, and the runners-up.
- ``migration``: the islands to which solutions move after an epoch.
"""
