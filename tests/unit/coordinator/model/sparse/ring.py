"""A ring of six states without noise: five products, and a quotient, which sums of products cannot say."""

from functools import cache

import numpy as np
from scipy.integrate import solve_ivp

from atoll_core.config import JobConfig, SpaceConfig
from atoll_core.data.table import Table

RING = tuple(f"x{place}" for place in range(6))
SUMS = JobConfig(space=SpaceConfig(operators=("+", "-", "*")))
TRUTHS = {name: f"x{place - 1}*x{place - 2} - {name}".replace("x-1", "x5").replace("x-2", "x4")
          for place, name in enumerate(RING[:5])}  # fmt: skip
"""The equations of all states but the last."""


def field(_, x):
    rates = [x[place - 1] * x[place - 2] - x[place] for place in range(5)]
    return [*rates, 2.0 / (1.0 + x[0] * x[0]) - x[5]]


@cache
def ring(noise=0.0):
    """Return six trajectories of 41 rows; `noise` is in units of the states."""
    times = 0.05 * np.arange(41)
    generator = np.random.default_rng(1)
    starts = generator.uniform(0.2, 1.5, (6, 6))
    values = np.hstack(
        [solve_ivp(field, (0.0, 2.0), start, "LSODA", times, rtol=1e-11, atol=1e-11).y for start in starts]
    )
    values += noise * generator.normal(size=values.shape)
    columns, zero = np.vstack([np.tile(times, 6), values]), np.zeros(246, np.int64)
    return Table(("t", *RING), ("",) * 7, columns, tuple(range(0, 246, 41)), ("made",), zero, zero + 1)
