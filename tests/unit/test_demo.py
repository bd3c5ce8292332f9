"""The comparison at the end of the demo: it must not praise what is wrong."""

import pytest

from examples.demo import TRUTH, compare


def equation(variable: str, expression: str) -> dict[str, str]:
    return {"lhs": f"d{variable}/dt", "variable": variable, "expression": expression}


def verdict(x: str, y: str = TRUTH["y"]) -> bool:
    return compare({"equations": [equation("x", x), equation("y", y)]})


@pytest.mark.parametrize(
    "expression",
    [
        TRUTH["x"],
        "x*(3.0001 - x - 2.0*y)",
        "-2*(x*y + 0.70710678*x*(0.70710678*x - 2.1213203))",
        "(6*x - 2*x**2 - 4*x*y)/2.0 + 1e-9*y",
        "-(-x)*(3 - (x + y) - y)",
    ],
)
def test_the_true_equation_is_known_in_any_arrangement(expression: str) -> None:
    assert verdict(expression)


@pytest.mark.parametrize(
    "expression",
    ["x*(3.002 - x - 2*y)", "x*(3 - x)", "x*(3 - x - 2*y) + 0.01*y", "x*(3 - x - 2*sin(y))", "x*(3 - x - 2*y)/(1 + y)"],
)
def test_any_other_equation_is_not(expression: str) -> None:
    assert not verdict(expression)
