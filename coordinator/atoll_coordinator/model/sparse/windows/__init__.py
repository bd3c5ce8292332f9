"""Laws by regression on short windows with errors in all variables: for many variables with noise.

- `window_rows`: windows along trajectories, by two quadratures, and the errors of the variables
- `terms`: terms integrated over windows, and the errors that those of the variables give them
- `window_sums`: sums of terms fitted so that small coefficients are not favoured, the shortest of them
- `window_laws`: the law of one state, if its windows have one

The reasons and figures: ADR 0048.
"""
