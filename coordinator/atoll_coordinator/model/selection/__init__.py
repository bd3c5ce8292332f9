"""Which equations together are the model: candidates become systems, systems are compared, the shortest wins.

- `stages`: the way in, `select_model`: the table of stages that propose candidates and compare systems
- `task`: what is modelled (`ModellingTask`), and the system that is chosen (`SelectedModel`)
- `proposals`: what proposes programs for an equation; none of it decides
- `pool`: all candidates, ranked, and the best system of a few; `candidates` ranks those of one variable by its
  trajectories alone; `elimination` leaves out the least significant terms of a library one after another
- `comparison`: systems fitted to the same measurements and measured in nats: `ModelComparison`, `FittedModel`;
  `fit_batches` has these fits as they travel to other machines and back
- `joint_search`: the best combination, one variable exchanged at a time; `local_search`: shorter descriptions nearby
- `shortcut`: laws of sparse regression that stand at the noise level, fitted together: no search around them
- `piece_lengths`: how much of a trajectory is simulated at a stretch
- `solver_errors`: the errors of the solver that computed a table, found by computing it again, and taken off
- `alternatives`: what comes closest to the model, and whether one of these predicts better (`cross_validation`)
- `rounding`: constants of the model made simple numbers
"""
