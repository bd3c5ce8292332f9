"""Derivatives of programs against sympy's, differences, and the sweep of numbers by constants."""

import math

import numpy as np
import pytest
import sympy

from atoll_core.expression.derivative import derivative, with_variables
from atoll_core.expression.evaluation import NUMPY, function_of, values_and_gradient, values_of
from atoll_core.expression.operators import ARITY, CONSTANT, OPERATORS, VARIABLE
from atoll_core.expression.program import Program, constant_places
from atoll_core.expression.text.export import to_sympy
from atoll_core.expression.text.parsing import from_infix

NAMES = ("x", "y", "z")
SYMBOLS = tuple(sympy.Symbol(name, real=True) for name in NAMES)
TEXTS = (
    "x*y*z - x/y + 3",
    "sin(x*y) + cos(x - z)",
    "exp(-x)*log(y) + sqrt(x*y)",
    "tanh(x/2)*abs(y - 1) + x**2.5",
    "1/(x + y**2) - x**y",
    "abs(x - y)**1.7 - tan(z/4) + cot(y) - (x + z)**2",
    "2.5",
)


def random_program(seed: int) -> Program:
    """Return a program of up to 14 nodes in which each operator is as likely as the others."""
    draw = np.random.default_rng(seed)
    nodes = [(VARIABLE, 0, 0, 0.0), (VARIABLE, 1, 0, 0.0), (VARIABLE, 2, 0, 0.0), (CONSTANT, 0, 0, draw.uniform(-2, 2))]
    for place in range(4, int(draw.integers(5, 15))):
        code = int(draw.integers(2, len(OPERATORS)))
        left, right = draw.integers(max(0, place - 4), place), draw.integers(0, place)
        nodes.append((code, int(left), int(right) if ARITY[code] == 2 else 0, 0.0))
    return Program.of(nodes)


def points(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.2, 1.6, (len(NAMES), 5))


def exact(formula: sympy.Expr, rows: np.ndarray) -> np.ndarray:
    """Return the values of a formula, computed with forty digits; NaN where they are not real, finite and moderate."""
    values = [formula.doit().evalf(40, subs=dict(zip(SYMBOLS, row, strict=True))) for row in rows.T.tolist()]
    return np.array([float(value) if value.is_real and abs(value) < 1e6 else math.nan for value in values])


def agree(values: np.ndarray, expected: np.ndarray) -> None:
    known = np.isfinite(expected)
    np.testing.assert_allclose(values[known], expected[known], rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("seed", range(30))
def test_first_and_second_derivatives_of_random_programs_are_those_of_sympy(seed: int) -> None:
    program, rows = random_program(seed), points(seed)
    names = {sympy.Symbol(name): symbol for name, symbol in zip(NAMES, SYMBOLS, strict=True)}
    formula = to_sympy(program, NAMES).subs(names)
    if not np.isfinite(values_of(program, rows)).all():
        return  # sympy, which arranges formulas anew, has values where programs have none
    for first, symbol in enumerate(SYMBOLS):
        partial = derivative(program, first)
        agree(values_of(partial, rows), exact(formula.diff(symbol), rows))
        agree(values_of(derivative(partial, first), rows), exact(formula.diff(symbol, 2), rows))


@pytest.mark.parametrize("text", TEXTS)
def test_first_and_second_derivatives_are_differences(text: str) -> None:
    program, rows, step = from_infix(text, NAMES), points(1), 1e-5
    for first, move in enumerate(step * np.eye(3)[:, :, None]):
        partial = derivative(program, first)
        difference = (values_of(program, rows + move) - values_of(program, rows - move)) / (2 * step)
        np.testing.assert_allclose(values_of(partial, rows), difference, rtol=1e-6, atol=1e-6)
        for second, other in enumerate(step * np.eye(3)[:, :, None]):
            difference = (values_of(partial, rows + other) - values_of(partial, rows - other)) / (2 * step)
            np.testing.assert_allclose(values_of(derivative(partial, second), rows), difference, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("seed", range(200))
def test_derivatives_by_constants_are_those_of_the_sweep_of_numbers(seed: int) -> None:
    program, rows = random_program(seed), points(seed)
    places = constant_places(program)
    _, expected = values_and_gradient(program, rows, places)
    more = np.vstack([rows, np.repeat(program.constants[places][:, None], rows.shape[1], axis=1)])
    for number, adjoints in enumerate(expected):
        values = values_of(derivative(with_variables(program, 3), 3 + number), more)
        np.testing.assert_allclose(values, adjoints, rtol=1e-9, atol=1e-300)


@pytest.mark.parametrize(
    ("text", "by", "point", "expected"),
    [
        ("abs(x)", "x", (0.0, 1.0), 0.0),
        ("abs(x)", "xx", (0.0, 1.0), 0.0),
        ("x**y", "y", (0.0, 2.0), 0.0),
        ("x**y", "yy", (0.0, 2.0), 0.0),
        ("x**y", "y", (0.0, 0.0), -math.inf),
        ("x**y", "x", (0.0, 1.0), 1.0),
        ("x**y", "x", (-2.0, 3.0), 12.0),
        ("x**y", "x", (0.0, 0.5), math.nan),
        ("sqrt(x)", "x", (0.0, 1.0), math.inf),
        ("log(x)", "x", (0.0, 1.0), math.inf),
        ("sin(x)", "x", (1e6, 1.0), math.nan),
    ],
)
def test_singular_points_are_those_of_the_table(
    text: str, by: str, point: tuple[float, float], expected: float
) -> None:
    program = from_infix(text, NAMES)
    for name in by:
        program = derivative(program, NAMES.index(name))
    np.testing.assert_equal(values_of(program, np.array([*point, 0.0])[:, None]), np.array([expected]))


@pytest.mark.parametrize("seed", range(30))
def test_a_function_of_several_programs_has_the_bits_of_each(seed: int) -> None:
    program, rows = random_program(seed), points(seed)
    programs = [program, *(derivative(program, variable) for variable in range(3)), from_infix("-2.5", NAMES)]
    with np.errstate(all="ignore"):
        values = np.broadcast_arrays(*function_of(programs, 3, NUMPY)(*rows), rows[0])[:-1]
    np.testing.assert_array_equal(values, [values_of(part, rows) for part in programs])
