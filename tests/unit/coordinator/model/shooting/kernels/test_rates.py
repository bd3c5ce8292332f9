"""Rates of a system's states and their derivatives, against evaluation by numpy."""

import numpy as np
import pytest

from atoll_coordinator.model.shooting.kernels.rates import rates, slopes
from atoll_coordinator.model.shooting.system import system_of
from atoll_core.compilation.jit import kernel
from atoll_core.expression.evaluation import value_of, values_and_gradient
from atoll_core.expression.kernels.functions import STRICT
from atoll_core.expression.operators import BY_NAME
from atoll_core.expression.program import constant_places
from tests.oracles.programs import program_of
from tests.unit.common.expression.kernels.test_tape import gradient as kernel_gradient


@kernel
def evaluated(tape, values, adjoints, rate, jacobian, direct) -> None:
    rates(tape, rate[0], values, 0, rate)
    slopes(tape, values, adjoints, jacobian, direct)


def rate_and_slopes(name: str, a: float, b: float) -> tuple[float, list[float]]:
    """Return the value of an operator on fitted constants, and its derivatives with respect to them."""
    operator = BY_NAME[name]
    system = system_of([program_of([a, b, (operator.code, *range(operator.arity))])], ("x",), ("x",))
    rate, direct = np.zeros((1, 1)), np.zeros(2)
    evaluated(system.tape, np.zeros(3), np.zeros(3), rate, np.zeros((1, 1)), direct)
    return rate[0, 0], direct[: operator.arity].tolist()


@pytest.mark.parametrize(("a", "b"), [(0.7, 1.9), (2.5, -0.4)])
@pytest.mark.parametrize("name", BY_NAME)
def test_every_operator_has_the_value_and_the_slopes_of_its_definition(name, a, b):
    operator = BY_NAME[name]
    program = program_of([a, b, (operator.code, *range(operator.arity))])
    values, gradient = values_and_gradient(program, np.zeros((1, 1)), constant_places(program))
    rate, slopes = rate_and_slopes(name, a, b)
    assert rate == pytest.approx(values[0], rel=1e-14)
    assert slopes == pytest.approx(gradient[: operator.arity, 0].tolist(), rel=1e-14)


def numpy_slopes(name: str, a: float, b: float) -> list[float]:
    """Return the derivatives of an operator from numpy's evaluation."""
    arity = BY_NAME[name].arity
    program = program_of([a, b, (BY_NAME[name].code, *range(arity))])
    _, gradient = values_and_gradient(program, np.zeros((1, 1)), constant_places(program))
    return [float(slope) for slope in gradient[:arity, 0]]


def search_slopes(name: str, a: float, b: float) -> list[float]:
    """Return the derivatives of an operator from the kernels of the search."""
    operator = BY_NAME[name]
    program = program_of([a, b, (operator.code, *range(operator.arity))])
    return [float(slope) for slope in kernel_gradient(program, [[0.0]])[: operator.arity, 0]]


@pytest.mark.parametrize(
    ("name", "a", "b", "expected"),
    [
        ("abs", 0.0, 1.0, [0.0]),
        ("pow", 0.0, 1.5, [0.0, 0.0]),
        ("pow", 0.0, 0.5, [np.nan, 0.0]),
        ("pow", 0.0, 0.0, [np.nan, -np.inf]),
        ("pow", 0.0, -1.0, [np.nan, np.nan]),
        ("pow", -2.0, 2.0, [-4.0, np.nan]),
        ("pow", -2.0, 0.5, [np.nan, np.nan]),
        ("log", 0.0, 1.0, [np.inf]),
        ("sqrt", 0.0, 1.0, [np.inf]),
        ("inverse", 0.0, 1.0, [-np.inf]),
    ],
)
def test_slopes_at_singular_points_are_the_same_everywhere(name, a, b, expected):
    """0**b is 0 for all b > 0. Powers of a negative base exist only for integer exponents.

    Therefore they have no derivative with respect to the exponent.
    """
    with np.errstate(all="ignore"):
        for slopes_of in (rate_and_slopes(name, a, b)[1], numpy_slopes(name, a, b), search_slopes(name, a, b)):
            np.testing.assert_array_equal(slopes_of, expected)


@pytest.mark.parametrize(
    ("name", "a", "b", "expected"),
    [
        ("log", 0.0, 1.0, -np.inf),
        ("log", -1.0, 1.0, np.nan),
        ("pow", 0.0, 0.0, 1.0),
        ("pow", 0.0, -1.0, np.nan),
        ("pow", -2.0, 3.0, -8.0),
        ("pow", -2.0, 0.5, np.nan),
        ("inverse", 0.0, 1.0, np.inf),
    ],
)
def test_values_at_singular_points_are_the_same_everywhere(name, a, b, expected):
    """If log(0) were infinite in one module and NaN in another, exp(log(0)) would be 0 in one and NaN in the other."""
    code = BY_NAME[name].code
    with np.errstate(all="ignore"):
        slopes = [
            rate_and_slopes(name, a, b)[0],
            value_of(code, a, b),
            STRICT[code].value(np.float64(a), np.float64(b)),
        ]
    np.testing.assert_array_equal(slopes, [expected] * 3)
