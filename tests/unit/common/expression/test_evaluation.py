"""Values and derivatives by numpy agree with the kernels and with differences."""

import numpy as np
import pytest

from atoll_core.expression.evaluation import values_and_gradient, values_of
from atoll_core.expression.program import constant_places, with_constants
from atoll_core.expression.text.parsing import from_infix
from tests.oracles.evaluate import evaluate

EVERY_OPERATOR = (
    "sin(1.5*x) + cos(y/0.7) - exp(-0.3*x)*log(2.5 + y) + sqrt(x + 3.5)/abs(y - 4.5) + tanh(0.4*x)*(x + 1.25)**(0.6*y)"
    " + (x - 0.2)**2"
)


def inputs() -> np.ndarray:
    draw = np.random.default_rng(1)
    return np.stack([draw.uniform(0.1, 2.0, 40), draw.uniform(-1.0, 1.0, 40)])


def test_values_are_those_of_the_slow_obvious_version():
    program = from_infix(EVERY_OPERATOR, ("x", "y"))
    expected = [evaluate(program, row) for row in inputs().T.tolist()]
    assert values_of(program, inputs()) == pytest.approx(np.array(expected), rel=1e-13)


def test_derivatives_with_respect_to_constants_are_differences():
    program = from_infix(EVERY_OPERATOR, ("x", "y"))
    places = constant_places(program)
    values, gradient = values_and_gradient(program, inputs(), places)
    assert values.tolist() == values_of(program, inputs()).tolist()
    for row, place in zip(gradient, places, strict=True):
        step = 1e-6
        above, below = (
            values_of(with_constants(program, {place: program.constants[place] + by}), inputs()) for by in (step, -step)
        )
        assert row == pytest.approx((above - below) / (2.0 * step), rel=1e-6, abs=1e-8)


def test_the_sine_of_a_large_number_is_no_number():
    assert np.isnan(values_of(from_infix("sin(1e6*x)", ("x", "y")), inputs())).all()
