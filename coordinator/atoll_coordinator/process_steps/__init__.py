"""Stochastic processes dx = f dt + g dW: the moments of a step, and random paths with these moments.

- `moments`: mean and covariance of a step
- `paths`: random paths, ensembles of paths, and the stationary density

The reasons and figures: ADR 0044.
"""

from typing import Literal

Discretisation = Literal["local linearisation", "Euler-Maruyama"]
"""The meaning of a step between two rows: it is a time step of the process (local linearisation), or a step of the
numerical method with this name (Euler-Maruyama)."""
