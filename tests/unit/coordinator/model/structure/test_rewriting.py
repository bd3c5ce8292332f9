"""Programs rewritten as real algebra allows."""

import numpy as np
import pytest

from atoll_coordinator.model.regression.gradient import values_of
from atoll_coordinator.model.structure.neighbours import neighbours
from atoll_coordinator.model.structure.rewriting import constant_places, reductions, structure, tidied
from tests.unit.coordinator.model.fitting import parsed, shown

ROWS = np.stack([np.linspace(0.5, 3.0, 20), np.linspace(-2.0, 1.9, 20)])
ALL = frozenset(range(2, 17))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1.0*x + 0.0*y", "x"),
        ("x - (-y)", "x + y"),
        ("x/1.0 - 0.0", "x"),
        ("(-1.0)*x + y", "y - x"),
        ("(-x)*(-y)", "x*y"),
        ("cos(-x - y)", "cos(x + y)"),
        ("x/4.0", "0.25*x"),
        ("(-x)/y + 0.0/x", "-(x/y)"),
        ("x - x", "0.0"),
        ("x/x + y", "1.0 + y"),
        ("-(x - y)", "y - x"),
        ("sin(-x)*2.0", "-(sin(x)*2.0)"),
        ("cos(x*(-2.0))", "cos(2.0*x)"),
        ("2.0*3.0 + sin(0.0)*x", "6.0"),
    ],
)
def test_neutral_elements_and_needless_signs_go(text, expected):
    assert structure(tidied(parsed(text))) == structure(parsed(expected))
    assert values_of(tidied(parsed(text)), ROWS) == pytest.approx(values_of(parsed(text), ROWS), abs=1e-15)


def test_constants_are_put_in_before_tidying():
    program = parsed("2.5*x + 0.1*y")
    first, second = constant_places(program)
    assert shown(tidied(program, {first: 1.0, second: 0.0})) == "x"


def reduced_to(text: str) -> list[str]:
    return [shown(program) for program in reductions(parsed(text))]


def test_an_operator_gives_way_to_its_arguments_or_a_constant():
    assert {"x", "-sin(y)", "x - y", "x - 1.5"} <= set(reduced_to("x - sin(y)"))


def test_a_constant_gives_way_to_neutral_elements():
    assert {"y", "x + y", "y - x"} <= set(reduced_to("2.5*x + y"))


def test_a_shared_factor_is_taken_out():
    assert any(
        text in ("(2.0*y + 3.0)*x", "x*(2.0*y + 3.0)", "x*(3.0 + 2.0*y)") for text in reduced_to("2.0*y*x + 3.0*x")
    )
    assert any("/y" in text and text.count("y") == 1 for text in reduced_to("sin(x)/y - cos(x)/y"))


def test_phases_and_double_angles_are_tried_away():
    assert "cos(x)" in reduced_to("sin(x + 1.5708)")
    assert "cos(y)**2" in reduced_to("cos(2.0*y)")
    assert "1.5*cos(y)**2" in neighbours_of("1.5*cos(y + y)")


def test_reductions_are_smaller_and_told_once():
    program = parsed("0.45*cos(2.0*y)*sin(x) + 0.55*sin(x) - x/(1.0 + y)")
    found = list(reductions(program))
    assert len({structure(each) for each in found}) == len(found) > 20
    assert all(len(each) <= len(program) for each in found)


def neighbours_of(text: str, operators=ALL, variables=(0, 1)) -> list[str]:
    return [shown(program) for program in neighbours(parsed(text), variables, operators)]


def test_a_constant_may_become_a_quotient():
    assert any("0.8/x" in text for text in neighbours_of("y/(x + 0.8)"))


def test_leaves_and_operators_are_exchanged_and_constants_joined():
    found = neighbours_of("sin(x)*y")
    assert {"sin(y)*y", "cos(x)*y", "sin(x)/y", "sin(x)*x"} <= set(found)
    assert any("1.001" in text for text in found)
    assert any("0.001" in text for text in found)


def test_only_operators_that_are_allowed_are_brought_in():
    assert not any("cos" in text or "/" in text for text in neighbours_of("sin(x)*y", frozenset({2, 3, 4})))


def test_only_variables_that_are_allowed_are_brought_in():
    assert any("x" in text for text in neighbours_of("sin(y)"))
    assert not any("x" in text for text in neighbours_of("sin(y)", variables=(1,)))
