"""The law of a stochastic process, dx = f dt + g dW, from candidates of the search: drift f and diffusion B = g g'.

- `likelihood`: the likelihood of all steps, also with measurement errors; fits constants
- `candidate_regression`: finds candidates for one equation while the other equations are fixed
- `process_choice`: `ProcessChoice.choose` chooses the law, the equations with the shortest description
- `path_ensembles`: ensembles of paths and the stationary density, for comparison with the measurements
- `checks`: quantity, limit and clause of each check of an equation, from the whitened steps
- `conclusion`: `summarize_process` prepares the shown equations and the reported model

`pipeline` calls `process_choice` and `conclusion`. The moments of a step and the paths of a process are in
`atoll_coordinator.process_steps`. The reasons and figures: ADR 0044.
"""
