"""The result of a job is made here; what it consists of is in `atoll_coordinator.result`.

- `result`: the whole; its parts: `diagnostics` (noise and smoothing), `trust` (alternatives,
  verdicts, simulations), `regression` (measured beside fitted values), `process_findings` (ensembles and densities of a
  stochastic process), `shared_terms` (what equations have in common), `source` (data, columns, settings), `known`
  (equations that were given), `digest` (what two runs must share), `numbers`

Refinements and fronts go in at `result`.
"""
