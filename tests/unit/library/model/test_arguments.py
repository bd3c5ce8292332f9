"""What is no number, or of the wrong shape, is one sentence of the argument that it was given for."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from atoll.api.model import Model
from atoll.model.arguments import numbers
from atoll_core.errors import UsageError
from tests.unit.library.model.results import result

MODEL = Model(result({"x": "-0.5*x + u", "y": "x - y"}, ("u",)))
BOX = {"x": (0.0, 1.0), "y": (0.0, 1.0)}
HELD = {"u": 0.0}


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: MODEL.simulate("abc", 1.0, HELD), "initial state must be numbers, but 'abc' was given"),
        (lambda: MODEL.simulate([1j, 1.0], 1.0, HELD), "initial state must be numbers"),
        (lambda: MODEL.simulate({"x": "a", "y": 1.0}, 1.0, HELD), "initial value of 'x' must be a number"),
        (lambda: MODEL.simulate([1.0, 1.0], "abc", HELD), "times must be numbers"),
        (lambda: MODEL.simulate([1.0, 1.0], 1.0, "abc"), "inputs must be numbers"),
        (lambda: MODEL.simulate([1.0, 1.0], 1.0, {"u": None}), "input 'u' must be numbers, but None"),
        (lambda: MODEL.simulate([1.0, 1.0], 1.0, lambda _: "a"), "the return value of u must be numbers"),
        (lambda: MODEL.predict([[1, 2], [3]], [[1], [2]]), "rows of x, y must be numbers"),
        (lambda: MODEL.predict(np.zeros((2, 2)), np.zeros((3, 1))), "u has 3 rows, but x has 2"),
        (lambda: MODEL.predict({"x": [1.0, 2.0], "y": [1.0], "u": [0.0]}), "columns have 1, 2 rows"),
        (lambda: MODEL.score(3), "needs columns by name, a frame or a list of these, but 3"),
        (lambda: MODEL.score({"t": ["a"], "x": [1.0], "y": [1.0], "u": [0.0]}), "column 't' must be numbers"),
        (lambda: MODEL.conf_int("a"), "a level must be a number"),
        (lambda: MODEL.analyse("abc"), "the box must be given by name"),
        (lambda: MODEL.analyse({"x": 3}), "the bounds of 'x' must be two numbers"),
        (
            lambda: MODEL.analyse({"x": (1.0, 0.0)}),
            "the bounds of 'x' must be a finite lower bound and a larger upper bound",
        ),
        (lambda: MODEL.analyse(BOX, inputs={"u": "a"}), "the input 'u' must be a number"),
        (lambda: MODEL.analyse(BOX, vary="c1"), "vary must be a name and a range"),
        (lambda: Model.load(3), "a path must be text"),
        (lambda: Model({"schema": 1, "equations": 3}), "no result of this version"),
        (lambda: Model({"schema": 1, "symbols": {}, "equations": [{"expression": "x"}]}), "no result of this version"),
    ],
)
def test_what_does_not_fit_is_one_sentence(call: Callable[[], Any], sentence: str) -> None:
    with pytest.raises(UsageError, match=sentence):
        call()


def test_missing_numbers_in_an_array_are_not_a_number() -> None:
    assert np.isnan(numbers([1.0, None], "x")[1])


def test_masked_numbers_are_missing() -> None:
    found = numbers(np.ma.array([1, -9999], mask=[False, True]), "states")
    assert str(found.tolist()) == "[1.0, nan]"
