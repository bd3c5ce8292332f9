"""What pages draw of a model: curves of all trajectories beside what was measured, and fitted values."""

import json

import pytest

from atoll.client.job_options import OPTIONS
from atoll.text.render import pick
from atoll.web.page_options import LABELS
from atoll.web.pictures import progress, simulation_of
from atoll_coordinator.result.result import Result
from tests.unit.library.report.results import dynamics, regression


def test_curves_and_measured_points_are_given_for_each_trajectory() -> None:
    answer = simulation_of(Result.of(dynamics()))
    (part,) = answer["trajectories"]
    assert part["measured"]["x"] == [1.0, 1.5, 2.0]
    assert part["measured_times"] == [0.0, 0.5, 1.0]
    assert {name: len(values) for name, values in part["values"].items()} == dict.fromkeys("xy", len(part["times"]))
    assert answer["labels"] == {"t": "t", "x": "x", "y": "y"}
    json.dumps(answer, allow_nan=False)


def test_an_equation_that_was_picked_is_drawn_from_the_first_measured_state() -> None:
    contents = dynamics()
    times = [0.0, 1.0, 2.0]
    measured = {"x": [1.0, 0.9, 0.8], "y": [3.0, 2.0, 1.5]}
    contents["data"]["trajectories"] = [{"name": "1", "times": times, "measured": measured}]
    (part,) = simulation_of(pick(Result.of(contents), {"x": 1}))["trajectories"]
    assert part["measured"] == measured
    assert part["values"]["x"][0] == 1.0
    assert len(part["times"]) > 10


def test_a_regression_has_fitted_values() -> None:
    contents = regression()
    contents["system"]["kind"] = "regression"
    contents["symbols"] = {"x": "x"}
    answer = simulation_of(Result.of(contents))
    assert answer["fitted"] == {"target": "y", "measured": [0.5, 4.0, 2.0], "fitted": [0.0, 4.0, 2.0]}


def test_what_is_no_model_has_a_sentence() -> None:
    contents = dynamics()
    contents["equations"][0]["expression"] = None
    assert "no model" in simulation_of(Result.of(contents))["message"]


def test_expressions_have_the_digits_of_the_terminal_and_constants_their_errors() -> None:
    contents = dynamics()
    contents["equations"][0]["front"][0]["expression"] = "0.123456789012345*x"
    first = progress(Result.of(contents))["equations"][0]
    assert first["front"][0]["expression"] == "0.123457*x"
    assert first["constants"] == "3 (3.00 ± 0.10)"
    assert first["candidates"][0]["nats"] == 2.5


@pytest.mark.parametrize("name", OPTIONS)
def test_each_option_is_called_by_words_on_a_page(name: str) -> None:
    assert name in LABELS
