"""What pages draw: of bounded size, whatever a job is."""

import json

import numpy as np
import pytest

from atoll.web.pictures import MAX_CURVES, MAX_POINTS, progress, some
from atoll_coordinator.result.result import Result
from tests.unit.library.model.results import bioreactor


def result(islands: int, steps: int) -> Result:
    curves = [
        {"island": k, "generations": [*range(steps)], "errors": [1.0 / (1 + k + n) for n in range(steps)]}
        for k in range(islands)
    ]
    equation = {
        "variable": "x", "lhs": "dx/dt", "expression": "-x", "convergence": curves,
        "front": [{"expression": "-x", "complexity": 2, "error": 0.1, "selected": True}],
    }  # fmt: skip
    return Result.of({"schema": 1, "job": "j", "equations": [equation], "symbols": {"x": "x"}})


def test_few_islands_are_drawn_one_by_one() -> None:
    (equation,) = progress(result(3, 10))["equations"]
    assert [curve["island"] for curve in equation["convergence"]] == [0, 1, 2]
    assert equation["convergence"][1]["errors"][0] == 0.5
    assert equation["plateau"] == 9
    assert equation["front"][0]["selected"]


def test_a_given_side_is_drawn_with_its_values_and_unknown_parts() -> None:
    first, second = progress(Result.of(bioreactor()))["equations"]
    assert second["expression"] == "0.2*(3 - S) - S/(0.6 + 2*S)*X/0.5"
    assert second["given"][0] == "given: -?1(S)*X/Y + 0.2*(3 - S)"
    assert [line.partition(" = ")[0] for line in second["given"][1:]] == ["Y", "?1"]
    assert "<mi>Y</mi>" in second["mathml"]
    assert second["constants"].count("(") == 2  # the parameter is not listed twice
    assert [line.partition(" = ")[0] for line in first["given"][1:]] == ["?1"]
    assert "given" not in progress(result(1, 1))["equations"][0]


@pytest.mark.parametrize("islands", [1, MAX_CURVES, MAX_CURVES + 1, 1024])
def test_the_size_does_not_grow_with_the_job(islands) -> None:
    made = progress(result(islands, 100_000 // islands + 100))
    (equation,) = made["equations"]
    points = sum(len(curve["errors"]) for curve in equation["convergence"])
    assert points <= MAX_POINTS + len(equation["convergence"])
    assert len(json.dumps(made, allow_nan=False)) < 100_000


def test_of_many_islands_best_median_and_worst_are_drawn() -> None:
    curves = progress(result(101, 50))["equations"][0]["convergence"]
    assert [curve["island"] for curve in curves] == ["best", "median", "worst"]
    best, median, worst = (curve["errors"][-1] for curve in curves)
    assert (best, median, worst) == pytest.approx((1 / 150, 1 / 100, 1 / 50), rel=1e-3)


def test_some_keeps_the_ends() -> None:
    assert some(5, 10) == [0, 1, 2, 3, 4]
    kept = some(1000, 7)
    assert (kept[0], kept[-1], len(kept)) == (0, 999, 7)
    assert np.all(np.diff(kept) > 0)
