"""Refinements of made tables by pools that tests give."""

import numpy as np

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.pipeline import refine_all
from atoll_core.config import JobConfig, SpaceConfig
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import constant_places
from tests.unit.coordinator.model.shooting.made import pools, table

TIMES = 0.1 * np.arange(40.0)
ARITHMETIC = SpaceConfig(operators=("+", "-", "*"))
NO_LIBRARIES = SpaceConfig(operators=("-", "*"))
"""Without sums there are none, which would take longer than all the rest."""

NOTHING_ELSE = JobConfig(space=NO_LIBRARIES)
LOTKA_STARTS = ([1.0, 3.0], [4.0, 1.0], [8.0, 2.0], [3.0, 3.0])
LOTKA_POOL = {
    "x": ("x", "1.2*x - x*x", "2.5*x - 1.5*x*y - 0.8*x*x"),
    "y": ("y", "1.2*y - y*y", "1.5*y - 0.5*x*y - 0.8*y*y"),
}


def refined(known, starts, pool, *, times=TIMES, noise=0.0, seed=0, config=None, batches=None):
    config = config or JobConfig(space=ARITHMETIC)
    preparation = prepare(table(known, starts, times, noise, seed), config)
    return refine_all(preparation, config, pools(preparation, **pool), batches=batches)


def check_of(refinement, name, check):
    return next(made for made in refinement.equations[name].checks if made.name == check)


def is_same(known, refinement, **truths):
    """Tell whether equations have the truths' functions, with simple constants."""
    draw = np.random.default_rng(5).uniform(0.5, 2.0, (len(known.names), 20))
    return all(
        np.allclose(values_of(refinement.equations[name].program, draw), values_of(known.parsed(text), draw), rtol=1e-9)
        for name, text in truths.items()
    )


def is_near(known, refinement, **truths):
    """Tell whether equations have about the truths' functions, and the truths' constants within five errors."""
    draw = np.random.default_rng(5).uniform(0.5, 2.0, (len(known.names), 20))
    for name, text in truths.items():
        truth, equation = values_of(known.parsed(text), draw), refinement.equations[name]
        if not np.allclose(values_of(equation.program, draw), truth, rtol=0.05, atol=0.05 * truth.std()):
            return False
        sizes = np.abs(known.parsed(text).constants[constant_places(known.parsed(text))])
        constants = [*equation.constants, *(coefficient.constant for coefficient in equation.unit_coefficients)]
        if not all(
            min(abs(abs(constant.fitted) - np.append(sizes, 1.0))) < 5.0 * constant.std_error for constant in constants
        ):
            return False
    return True
