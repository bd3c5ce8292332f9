"""Which equations together are the model: candidates become systems, systems are compared, the shortest wins.

- `stages`: the way in, `select_model`: the table of stages that propose candidates and compare systems
- `task`: the measurements and candidates (`ModellingTask`), and the chosen system (`SelectedModel`)
- `proposals`: functions that propose programs for an equation; the choice is made elsewhere
- `pool`: all candidates, ranked, and the best system of a few; `candidates` ranks the candidates for one variable
  by its trajectories alone
- `comparison`: systems fitted to the same measurements, here or by other machines, and measured in nats by the `score`
- `joint_search`: the best combination, one variable exchanged at a time; `local_search`: shorter descriptions nearby
- `shortcut`: laws of sparse regression whose residuals are noise, fitted together, without a search around them
- `piece_lengths`: the rows of a trajectory that are simulated without a break
- `solver_errors`: the errors of the solver that computed a table, found by computing it again, and subtracted
- `alternatives`: the closest alternatives to the model, and whether one of these predicts better (`cross_validation`)
"""
