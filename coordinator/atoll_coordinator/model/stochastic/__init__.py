"""The law of a stochastic process, dx = f dt + g dW, from candidates of the search: drift f and diffusion B = g g'.

- `likelihood`: of all steps, also with errors of measurement; constants fitted, their information
- `regression`: candidates for one equation, the others as they are
- `process_choice`: equations exchanged one after another, the shortest description
- `path_ensembles`: ensembles and the stationary density, compared with the measurements
- `checks`: quantity, limit and clause of each check of an equation, by the whitened steps
- `conclusion`: equations as they are shown, the reported model

`pipeline` calls `process_choice` and `conclusion`. The moments of a step and the paths of a process are in
`atoll_coordinator.stochastic`. The reasons and figures: ADR 0044.
"""
