"""Which equations together are the model: candidates are combined into systems, and the system with the shortest
description is chosen.

- `model_selection`: `select_model`, the entry point, and the table of stages that propose candidates and compare
  systems
- `front_member`: which member of a front is shown while the search runs
- `task`: the measurements and candidates (`ModellingTask`), and the chosen system (`SelectedModel`)
- `proposals`: functions that propose programs for an equation
- `pool`: the ranked candidates of all equations, and the best system made of a few candidates; `candidates` ranks the
  candidates for one variable by its trajectories alone
- `comparison`: fits systems to the same measurements, here or on workers; `score` computes their length in nats
- `joint_search`: finds the best combination by exchanging the program of one variable at a time; `local_search`: finds
  shorter descriptions by changes at single nodes
- `shortcut`: if sparse regression found laws whose residuals are noise, these laws are fitted together, without a
  search
- `piece_lengths`: the number of rows of a trajectory that are simulated without a break
- `solver_errors`: reproduces the errors of the solver that computed a table, and subtracts them
- `alternatives`: the closest alternatives to the model, and how well each predicts (`cross_validation`)
"""
