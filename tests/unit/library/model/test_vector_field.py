"""Right-hand sides as functions of numbers, against the search's own evaluation and against finite differences."""

import subprocess
import sys

import numpy as np
import pytest

from atoll.api.model import Model
from atoll.model.vector_field import VectorField
from atoll_coordinator.result.result import Result
from atoll_core.errors import UsageError
from atoll_core.expression.evaluation import values_of
from tests.unit.library.model.results import result

FUNCTIONS = VectorField.of(
    {
        "x": "1.5*sin(x)*exp(-0.3*y) - tanh(x*y) + u",
        "y": "sqrt(abs(y)) + log(2.0 + x**2) - cot(x)/3.0",
        "z": "abs(x - y)**1.7 + z**3 - tan(z/4.0)",
    },
    ["u"],
)


def test_values_are_those_of_the_programs() -> None:
    points = np.random.default_rng(1).uniform(0.2, 1.5, (50, 4))
    expected = np.array([values_of(program, points.T) for program in FUNCTIONS.programs]).T
    np.testing.assert_allclose(FUNCTIONS.values(points[:, :3], points[:, 3:]), expected, rtol=1e-12)
    np.testing.assert_allclose(FUNCTIONS.values(points[7, :3], points[7, 3:]), expected[7], rtol=1e-12)


def test_derivatives_agree_with_finite_differences() -> None:
    x, u, p, step = np.array([0.7, 1.1, 0.4]), np.array([0.2]), FUNCTIONS.values_of_parameters, 1e-6
    by_states = [(FUNCTIONS.values(x + s, u) - FUNCTIONS.values(x - s, u)) / (2 * step) for s in step * np.eye(3)]
    np.testing.assert_allclose(FUNCTIONS.jacobian(x, u), np.array(by_states).T, rtol=1e-7, atol=1e-8)
    moves = step * np.eye(len(p))
    by_parameters = [(FUNCTIONS.values(x, u, p + s) - FUNCTIONS.values(x, u, p - s)) / (2 * step) for s in moves]
    np.testing.assert_allclose(FUNCTIONS.parameter_derivatives(x, u), np.array(by_parameters).T, rtol=1e-7, atol=1e-8)
    assert FUNCTIONS.jacobian(np.array([x, x]), u).shape == (2, 3, 3)


def test_parameters_are_the_constants_in_order_and_can_be_replaced() -> None:
    field = VectorField.of({"x": "3.0*x - 2.0*x*y", "y": "y*(0.5 - x)"})
    assert [(parameter.name, parameter.variable, parameter.value) for parameter in field.parameters] == [
        ("c1", "x", 3.0), ("c2", "x", 2.0), ("c3", "y", 0.5)
    ]  # fmt: skip
    assert field.values([1.0, 1.0], p=[1.0, 4.0, 2.0]).tolist() == [-3.0, 1.0]


@pytest.mark.parametrize(
    ("text", "x"), [("1/x", 0.0), ("log(x)", 0.0), ("sqrt(x)", -1.0), ("exp(x)", 1e4), ("x**0.5", -1.0)]
)
def test_where_there_is_no_finite_value_is_nan(text: str, x: float) -> None:
    field = VectorField.of({"x": text, "y": "x"})
    assert np.isnan(field.values([x, 0.0])).tolist() == [True, False]
    assert np.isnan(field.values([[x, 0.0], [1.0, 0.0]])).tolist() == [[True, False], [False, False]]


def _equation(variable: str, lhs: str, expression: str | None) -> dict[str, object]:
    return {"variable": variable, "lhs": lhs, "expression": expression}


def _field(equations: list[dict[str, object]], symbols: dict[str, str]) -> VectorField:
    return VectorField.from_result(Result.of({"schema": 1, "equations": equations, "symbols": symbols}))


def test_a_result_of_second_order_is_a_system_of_first_order() -> None:
    equations = [_equation("a", "d2a/dt2", "-a - 0.1*a_dot"), _equation("b", "d2b/dt2", "-b + a")]
    field = _field(equations, {"a": "a", "b": "b", "a_dot": "a_dot", "b_dot": "b_dot"})
    assert field.states == ("a", "b", "a_dot", "b_dot")
    assert field.values([1.0, 2.0, 3.0, 4.0]).tolist() == [3.0, 4.0, -1.3, -1.0]


def test_the_drift_of_a_process_is_its_field() -> None:
    equations = [_equation("x", "dx/dt", "-x"), _equation("g_x", "dg_x/dt", "0.1")]
    assert _field(equations, {"x": "x"}).expressions == ("-x",)


@pytest.mark.parametrize(
    ("equation", "message"),
    [(_equation("x", "x", "y"), "not differential"), (_equation("x", "dx/dt", None), "no equation for dx/dt")],
)
def test_results_without_dynamics_are_refused(equation: dict[str, object], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        _field([equation], {"x": "x", "y": "y"})


def test_wrong_shapes_are_named() -> None:
    with pytest.raises(UsageError, match=r"states have the shape \(2,\), expected \(3,\)"):
        FUNCTIONS.values([1.0, 2.0], [0.0])


def test_values_and_derivatives_need_no_sympy() -> None:
    code = (
        "import sys; from atoll.model.vector_field import VectorField\n"
        "field = VectorField.of({'x': '-x'}); field.jacobian(field.values([1.0])); assert 'sympy' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


@pytest.mark.parametrize("rate", ["1/(x - x)", "u*x + 1/(x - x)", "sqrt(-2.0)*x", "x + log(-2.0)"])
def test_rates_without_a_value_anywhere_are_nan(rate: str) -> None:
    field = VectorField.of({"x": rate, "y": "-y"}, ("u",))
    slopes = field.values(np.array([[1.0, 2.0], [0.5, 3.0]]), np.array([0.3]), field.values_of_parameters)
    assert np.isnan(slopes[:, 0]).all()
    assert slopes[:, 1].tolist() == [-2.0, -3.0]


def test_what_a_constant_is_the_coefficient_of_is_written_with_a_logarithm_where_it_is_an_exponent() -> None:
    field = Model(result({"x": "2.5*x**1.5"})).field
    values = np.array([2.5, 1.5])
    assert [field.term_of(index, values) for index in range(2)] == ["x**1.5", "2.5*x**1.5*log(x)"]
