"""Which equations together are the model: candidates become systems, systems are compared, the shortest wins.

- `candidates`: the programs of each variable, by where they come from, ranked by that variable's trajectories alone
- `elimination`: candidates from libraries of terms, the least significant left out one after another
- `comparison`: systems fitted to the same measurements: `ModelComparison`, `FittedModel`
- `joint_search`: what is modelled (`ModellingTask`); the best combination, one variable exchanged at a time
- `local_search`: from a system to shorter descriptions nearby
- `shortcut`: laws of sparse regression that stand at the noise level, fitted together: no search around them
- `solver_errors`: the errors of the solver that computed a table, found by computing it again, and taken off
- `stretches`: pieces of nearly clean trajectories, in which a solver's errors do not add up
- `piece_lengths`: how much of a trajectory is simulated at a stretch: `select_model` is the way in
- `alternatives`: what comes closest to the model, and whether one of these predicts better (`cross_validation`)
- `rounding`: constants of the model made simple numbers

`pipeline` calls `piece_lengths`, which goes down to `shortcut`, `joint_search`, `local_search` and `comparison`.
"""
