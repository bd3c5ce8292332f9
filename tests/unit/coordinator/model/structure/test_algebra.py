"""Programs simplified as real algebra allows."""

import numpy as np
import pytest

from atoll.expression.evaluation import values_of
from atoll.expression.program import constant_places, structure, with_constants
from atoll_coordinator.model.structure.algebra import tidied
from tests.unit.coordinator.model.fitting import parsed, shown

ROWS = np.stack([np.linspace(0.5, 3.0, 20), np.linspace(-2.0, 1.9, 20)])


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
    assert shown(tidied(with_constants(program, {first: 1.0, second: 0.0}))) == "x"
