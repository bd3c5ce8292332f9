"""Poles within the region that points visit are found, and only these."""

import numpy as np
import pytest

from atoll_coordinator.model.structure.poles import find_poles
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from tests.unit.coordinator.model.fitting import parsed, shown

POINTS = np.random.default_rng(0).uniform([[0.2], [-1.0]], [[3.0], [1.0]], (2, 60))


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("x/(y - 0.3)", ["y - 0.3"]),
        ("x/(x - 1.33)", ["x - 1.33"]),
        ("x/(x - 1.33)**2", ["x - 1.33"]),
        ("cos(y)/sin(y)*x", ["sin(y)"]),
        ("1.0 + log(y)", ["y"]),
        ("y**(-1.5)", ["y"]),
        ("x/(y*(x + 1.0))", ["y"]),
    ],
)
def test_poles_among_the_points_are_found(text, parts):
    assert [shown(pole) for pole in find_poles(from_infix(text, ("x", "y")), POINTS)] == parts


@pytest.mark.parametrize("text", ["y/x", "1.0/(x + 0.1)", "y/(x - 5.0)", "sin(y)/y", "x/(y*y + 0.1)", "log(x)", "x*y"])
def test_elsewhere_there_are_none(text):
    assert find_poles(parsed(text), POINTS) == []


def test_along_a_trajectory_poles_are_those_between_neighbouring_points():
    """A state that rests at 0 from some row on, described by a pole just above it."""
    course = np.maximum(2.0 - 0.2 * np.arange(20.0), 0.0)[None]
    text = "6e-13/(3e-12 - x**3) - 0.2"
    parts = find_poles(from_infix(text, ("x",)), course[:, :-1], course[:, 1:])
    assert [to_infix(part, ("x",)) for part in parts] == ["3e-12 - x**3"]
    assert not find_poles(from_infix(text, ("x",)), course[:, :9], course[:, 1:10])
