"""Programs that differ from a program in one place."""

from atoll_coordinator.model.structure.moves.neighbours import neighbours
from tests.unit.coordinator.model.fitting import parsed, shown

ALL = frozenset(range(2, 17))


def neighbours_of(text: str, operators=ALL, variables=(0, 1)) -> list[str]:
    return [shown(program) for program in neighbours(parsed(text), variables, operators)]


def test_a_constant_may_become_a_quotient():
    assert any("0.8/x" in text for text in neighbours_of("y/(x + 0.8)"))


def test_leaves_and_operators_are_exchanged_and_constants_joined():
    neighbours = neighbours_of("sin(x)*y")
    assert {"y*sin(y)", "y*cos(x)", "sin(x)/y", "x*sin(x)"} <= set(neighbours)
    assert any("1.001" in text for text in neighbours)
    assert any("0.001" in text for text in neighbours)


def test_only_operators_that_are_allowed_are_brought_in():
    assert not any("cos" in text or "/" in text for text in neighbours_of("sin(x)*y", frozenset({2, 3, 4})))


def test_only_variables_that_are_allowed_are_brought_in():
    assert any("x" in text for text in neighbours_of("sin(y)"))
    assert not any("x" in text for text in neighbours_of("sin(y)", variables=(1,)))


def test_double_angles_are_tried_away():
    assert "1.5*cos(y)**2" in neighbours_of("1.5*cos(y + y)")
