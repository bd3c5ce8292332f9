"""Without trajectories, too, the same equation is chosen in whatever units columns are."""

import numpy as np
import pytest

from atoll_coordinator.model.constants.rounding import continuum_density, simple_numbers
from atoll_coordinator.model.pools import FrontMember
from atoll_coordinator.model.regression.equation import refine_equation
from atoll_core.config import JobConfig, SpaceConfig
from atoll_core.data.dataset import Problem, Target
from atoll_core.expression.text.parsing import from_infix
from atoll_core.expression.writing.expansion import form_of

UNITS = [(1e-6, 1.0), (1e6, 1.0), (1.0, 1e-6)]
SUMS = JobConfig(space=SpaceConfig(operators=("+", "-", "*")))


def chosen(of_x, of_y):
    """Return the equation chosen for y = 0.7314 x + 0.05 x² + 0.21 with noise, columns times these factors."""
    random = np.random.default_rng(5)
    x = random.uniform(0.5, 3.0, 200)
    y = 0.7314 * x + 0.05 * x * x + 0.21 + 0.05 * random.standard_normal(200)
    target = Target("y", "y", of_y * y, 0.0, of_y * float(y.std()))
    problem = Problem(("x",), of_x * x[None], target)
    slope, bend, offset = 0.7 * of_y / of_x, 0.03 * of_y / of_x**2, 0.2 * of_y
    texts = (f"{slope!r}*x", f"{slope!r}*x + {offset!r}", f"{slope!r}*x + {offset!r} + {bend!r}*x*x")
    front = [FrontMember(from_infix(text, ("x",)), of_y, of_y * of_y) for text in texts]
    return form_of(refine_equation(problem, SUMS, front).program)


@pytest.mark.slow
def test_the_same_equation_is_chosen_in_other_units():
    """It may be written in another way: its writings are equally long."""
    here = chosen(1.0, 1.0)
    assert all(chosen(*units) == here for units in UNITS)


@pytest.mark.parametrize("unit", [1e-6, 1e-3, 1e6, 1e12])
@pytest.mark.parametrize(("value", "error"), [(0.3312, 0.003), (12.0001, 1.1e-4), (2.5, 0.3), (1.5707963, 1e-6)])
def test_numbers_are_as_long_in_any_unit(value, error, unit):
    assert continuum_density(value * unit) * unit == pytest.approx(continuum_density(value))
    here, there = simple_numbers(value, error), simple_numbers(value * unit, error * unit)
    assert sorted(here.values()) == pytest.approx(sorted(there.values()))
    assert sorted(number * unit for number in here) == pytest.approx(sorted(there))


@pytest.mark.slow
def test_a_result_has_the_odds_of_simple_numbers_together():
    random = np.random.default_rng(2)
    x = random.uniform(0.5, 3.0, 300)
    y = 2.0 * x + 0.5 * x * x - 3.0 + 0.01 * random.standard_normal(300)
    problem = Problem(("x",), x[None], Target("y", "y", y, 0.0, float(y.std())))
    program = from_infix("1.9*x + 0.6*x*x - 2.9", ("x",))
    fitted = refine_equation(problem, SUMS, [FrontMember(program, 1.0, 1.0)])
    together = fitted.simple_together
    assert together.values == tuple(fitted.constants[place].value for place in together.constants)
    assert len(together.values) == len(fitted.constants) == 3
    assert 20.0 <= together.odds <= min(constant.simple.odds for constant in fitted.constants)
