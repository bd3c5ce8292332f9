"""Lorenz's system, measured: what several tests of sparse regression begin with."""

import numpy as np
from scipy.integrate import solve_ivp

from atoll_coordinator.data.prepare import prepare
from atoll_core.config import PRESETS
from atoll_core.data.table import Table

NAMES = ("x", "y", "z")
TERMS = {"x": {"x", "y"}, "y": {"x", "y", "x*z"}, "z": {"z", "x*y"}}
"""Monomials of each equation."""


def field(_, state):
    x, y, z = state
    return [10.0 * (y - x), x * (28.0 - z) - y, x * y - 8.0 / 3.0 * z]


def table(rows, noise, *, step=0.01, trajectories=1, seed=1, **options):
    """Return the table of simulated trajectories with noise, a share of each state's standard deviation."""
    generator = np.random.default_rng(seed)
    options = {"rtol": 1e-10, "atol": 1e-10, **options}
    times = step * np.arange(rows)
    parts = []
    for start in generator.uniform([-10, -10, 15], [10, 10, 35], (trajectories, 3)):
        begun = solve_ivp(field, (0.0, 5.0), start, rtol=1e-8, atol=1e-8).y[:, -1]
        parts.append(solve_ivp(field, (0.0, times[-1]), begun, t_eval=times, **options).y)
    values = np.concatenate(parts, axis=1)
    values = values + noise * values.std(axis=1, keepdims=True) * generator.normal(size=values.shape)
    columns = np.vstack([np.tile(times, trajectories), values])
    zero = np.zeros(columns.shape[1], np.int64)
    starts = tuple(rows * index for index in range(trajectories))
    return Table(("t", *NAMES), ("",) * 4, np.ascontiguousarray(columns), starts, ("made",), zero, zero + 1)


def prepared(rows, noise, config=PRESETS["default"], **options):
    return prepare(table(rows, noise, **options), config)


def monomials(text, names=NAMES):
    """Return the monomials of a polynomial over variables of these names, as text such as x*y."""
    import sympy

    symbols = sympy.symbols(names)
    polynomial = sympy.Poly(sympy.expand(sympy.sympify(text)), *symbols)
    return {
        "*".join(name for name, power in zip(names, powers, strict=True) for _ in range(power)) or "1"
        for powers in polynomial.monoms()
    }
