"""Stochastic processes dx = f dt + g dW: the moments of a step, and paths drawn with them.

- `moments`: mean and covariance of a step
- `paths`: paths, ensembles of them, and the density that they settle into

The reasons and figures: ADR 0044.
"""

from typing import Literal

Discretisation = Literal["local linearisation", "Euler-Maruyama"]
"""What a step is: a step of the process in time, or of the numerical method with this name."""
