"""Parsing: precedence, functions, natural powers, and refusals that point at the place."""

import math

import pytest

from atoll_core.errors import UsageError
from atoll_core.expression.operators import MULTIPLY, POW, SQUARE
from atoll_core.expression.text.parsing import from_infix
from tests.oracles.evaluate import evaluate

NAMES = ("x", "y", "θ", "pi_x")
ROW = (1.5, -0.75, 0.3, 2.0)
SCOPE = {
    **dict(zip(NAMES, ROW, strict=True)),
    **{name: getattr(math, name) for name in ("sin", "cos", "exp", "log", "sqrt", "tanh", "pi", "tan")},
    "abs": abs,
}


@pytest.mark.parametrize(
    "text",
    [
        "1 + 2*x - 3/y",
        "-x**2",
        "(-x)**2",
        "2**-x",
        "2**x**0.5",
        "x - y - θ",
        "x/y/θ",
        "x/(y*θ)",
        "-x*-y",
        "- -x",
        "+x",
        "x*(y + θ)*(x - y)",
        "sin(x)**2 + cos (y)",
        "exp(log(x))*sqrt(abs(y))",
        "tanh(x - 1e-3) + .5e1 + 2.",
        "2*pi*x",
        "tan(θ)",
        "x**3*y**2",
        "pi_x",
    ],
)
def test_expressions_mean_what_python_reads(text):
    assert evaluate(from_infix(text, NAMES), ROW) == pytest.approx(eval(text, {}, SCOPE), rel=1e-14)


def test_a_column_may_be_called_like_the_number_pi():
    assert evaluate(from_infix("pi + 1", ("pi",)), (5.0,)) == 6.0


def test_names_may_have_accents_and_combining_marks():
    names = ("x\u0304", "čas", "x_1")
    assert evaluate(from_infix("x\u0304*čas + x_1", names), (2.0, 3.0, 4.0)) == 10.0


def test_natural_powers_are_multiplications():
    assert SQUARE in from_infix("x**2", NAMES).operators
    assert POW not in from_infix("x**7", NAMES).operators
    assert POW in from_infix("x**2.0", NAMES).operators
    assert POW in from_infix("x**0", NAMES).operators
    assert len(from_infix("x**1", NAMES)) == 1
    assert list(from_infix("x**3", NAMES).operators).count(MULTIPLY) == 1


def test_equal_parts_become_one_node():
    assert len(from_infix("sin(x + y)*cos(x + y) + (x + y)", NAMES)) == 7


def test_brackets_may_be_nested_as_deep_as_they_like():
    depth = 20_000
    assert len(from_infix("(" * depth + "x" + ")" * depth, NAMES)) == 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "the text ends at character 1"),
        ("x +", "the text ends at character 4"),
        ("2x", "'x' stands at character 2"),
        ("x y", "'y' stands at character 3"),
        ("x^2", "powers are written [*][*]"),
        ("(x", "'[)]' was expected"),
        ("x)", "'[)]' stands at character 2"),
        ("sin()", "'[)]' stands at character 5"),
        ("x + q", "'q' at character 5 of 'x [+] q' is unknown; known: x, y, θ, pi_x"),
        ("gamma(x)", "'gamma' at character 1 of 'gamma[(]x[)]' is no known function"),
        ("x(y)", "is no known function"),
        ("x, y", "',' stands at character 2"),
        ("sin x", "'sin' at character 1"),
        ("*x", "stands at character 1"),
        ("x**", "the text ends"),
        ("1e400*x", "the number 1e400 at character 1 of '1e400[*]x' is too large"),
        ("x\n@", "'@' stands at character 3"),
    ],
)
def test_what_is_no_expression_is_refused_with_its_place(text, said):
    with pytest.raises(UsageError, match=said):
        from_infix(text, NAMES)


def test_too_many_different_parts_are_refused():
    with pytest.raises(UsageError, match="at most 240"):
        from_infix(" + ".join(f"{number}*x" for number in range(2, 200)), NAMES)
