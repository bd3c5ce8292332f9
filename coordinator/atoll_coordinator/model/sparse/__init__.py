"""Laws as sparse sums of products, found by regression alone: no simulation, no population, well under a second.

- `weak_form`: equations integrated against test functions, so that nothing is differentiated
- `laws`: backward elimination in the weak form, or on derivatives where there is no noise; the criterion
- `kernels`: least squares and elimination, compiled; `warmup` makes them ready

Candidates for `selection`, which judges them by trajectories. The reasons and figures: ADR 0036.
"""
