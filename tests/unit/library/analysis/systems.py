"""Systems of the literature, as flows and boxes."""

import numpy as np

from atoll.analysis.flow import Box, Flow
from atoll.model.vector_field import VectorField


def flow(**equations: str) -> Flow:
    """Return the flow of these equations."""
    return Flow.of(VectorField.of(equations))


def box(*sides: tuple[float, float]) -> Box:
    """Return the box of these bounds."""
    ends = np.array(sides, dtype=np.float64)
    return Box(ends[:, 0], ends[:, 1])


COMPETITION = flow(x="x*(3.0 - x - 2.0*y)", y="y*(2.0 - x - y)")
"""Strogatz, Nonlinear Dynamics and Chaos (1994), section 6.4: rabbits and sheep."""

VAN_DER_POL = flow(x="y", y="(1.0 - x**2)*y - x")
"""The period of mu = 1 is 6.66328686 (Andersen and Geer, SIAM J. Appl. Math. 42, 1982)."""

SUBCRITICAL = flow(x="x*(x**2 + y**2 - 1.0) - 2.0*y", y="y*(x**2 + y**2 - 1.0) + 2.0*x")
"""r' = r (r**2 - 1), phi' = 2: an unstable cycle of period pi and multiplier exp(2 pi) around a stable focus."""

LORENZ = flow(x="10.0*(y - x)", y="x*(28.0 - z) - y", z="x*y - 8.0/3.0*z")
"""Exponents 0.9056, 0, -14.5723 (Sprott, Chaos and Time-Series Analysis, 2003)."""
