"""Suggested experiments against closed forms, and sentences for what cannot be asked."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.special import lambertw, ndtr

from atoll.api.model import Model
from atoll.experiments.alternatives import without_poles
from atoll.experiments.designs import (
    DesignPrediction,
    DesignRequest,
    certainties,
    discrepancy,
    expected_gain,
    precision,
    useful_evidence,
)
from atoll.experiments.fits import equations_of, measured_of
from atoll.experiments.suggestion import suggest
from atoll_coordinator.result.result import Result
from atoll_core.errors import UsageError
from atoll_core.expression.text.infix import to_infix
from tests.unit.library.experiments.made import measured

TIMES = np.linspace(0.0, 2.0, 12)
NOISE = np.random.default_rng(2).standard_normal(12)
WIDE = {"x": (0.1, 20.0)}


def saturating() -> dict[str, Any]:
    """Return a result whose data, of x below 1, hardly tell -0.85 x from x' = -x/(1 + 0.25 x), which they are of."""
    x = 4.0 * lambertw(0.25 * np.exp(0.25 - TIMES)).real + 0.02 * NOISE
    result = measured({"x": "-0.85*x"}, [(TIMES, {"x": x})], 0.02)
    result["equations"][0]["candidates"] = [
        {"expression": "-0.85*x", "complexity": 3, "nats": 0.0, "origin": "front", "selected": True},
        {"expression": "-4*x/(4 + x)", "complexity": 7, "nats": 4.0, "origin": "library", "selected": False},
    ]
    return result


FOUND = saturating()
LINEAR = measured({"x": "-0.5*x"}, [(TIMES, {"x": 2.0 * np.exp(-0.5 * TIMES) + 0.01 * NOISE})], 0.01)


def test_candidates_are_told_apart_where_they_differ() -> None:
    suggestions = suggest(Result.of(FOUND), DesignRequest(WIDE))
    assert suggestions.purpose == "discrimination"
    assert suggestions.measured == ()
    assert sorted(candidate.origin for candidate in suggestions.candidates) == ["candidate", "shown"]
    assert sum(candidate.weight for candidate in suggestions.candidates) == pytest.approx(1.0)
    first = suggestions.experiments[0]
    assert first.initial["x"] > 5.0  # saturation shows where x is large
    assert len(first.times) == 12
    assert first.times[-1] == pytest.approx(2.0)
    assert 0.0 < first.information <= suggestions.entropy
    worths = [experiment.worth_per_cost for experiment in suggestions.experiments]
    assert worths == sorted(worths, reverse=True)
    starts = np.array([experiment.initial["x"] for experiment in suggestions.experiments])
    apart = np.abs(np.subtract.outer(starts, starts))[~np.eye(len(starts), dtype=bool)]
    assert apart.min(initial=np.inf) >= 0.25 * 19.9
    assert "experiment 1: x = " in str(suggestions)
    assert suggestions.verdict.startswith("The data ")
    assert "; decides between the two with " in str(suggestions)
    assert "nats of" not in str(suggestions)


def test_an_experiment_that_begins_outside_of_the_data_is_warned_of() -> None:
    suggestions = suggest(Result.of(FOUND), DesignRequest(WIDE))
    first = suggestions.experiments[0]
    assert first.remark.startswith(
        f"the initial state is outside of the measured range: x = {first.initial['x']:.4g} (measured"
    )
    assert f"  warning: {first.remark}" in str(suggestions).splitlines()
    within = suggest(Result.of(FOUND), DesignRequest({}))
    assert [experiment.remark for experiment in within.experiments] == [""] * len(within.experiments)


def test_certainties_are_those_of_two_gaussians_at_least() -> None:
    """Of equal spread and d apart, with B = d**2/8, the error with equal weights is that of the normal tail at d/2."""
    assert certainties(np.zeros((2, 2)), [0.7, 0.3]) == (pytest.approx(0.7),)
    for apart in (1.0, 3.0, 6.0):
        distances = np.full((2, 2), apart**2 / 8.0)
        (sure,) = certainties(distances, [0.5, 0.5])
        assert 0.5 <= sure <= ndtr(apart / 2.0)
    assert certainties(np.full((3, 3), 500.0), [0.5, 0.3, 0.2]) == (pytest.approx(1.0), pytest.approx(1.0))


def test_the_same_seed_suggests_the_same_and_the_model_as_well() -> None:
    first = suggest(Result.of(FOUND), DesignRequest(WIDE, count=2, seed=5)).as_dict()
    assert Model(FOUND).suggest(WIDE, count=2, seed=5).as_dict() == first
    assert len(first["experiments"]) <= 2


def test_costs_make_experiments_shorter() -> None:
    by_time = suggest(Result.of(FOUND), DesignRequest(WIDE, cost="duration", count=1)).experiments[0]
    by_sample = suggest(Result.of(FOUND), DesignRequest(WIDE, cost="samples", count=1)).experiments[0]
    assert by_time.cost == pytest.approx(by_time.times[-1])
    assert by_time.times[-1] < 2.0
    assert by_sample.cost == len(by_sample.times) < 12


def test_a_linear_model_alone_is_measured_where_its_constant_shows_most() -> None:
    suggestions = suggest(Result.of(LINEAR), DesignRequest({}))
    assert (suggestions.purpose, suggestions.reason) == ("precision", "there is only one candidate")
    assert suggestions.entropy == 0.0
    assert suggestions.measured == ("x",)
    best = suggestions.experiments[0]
    assert best.initial["x"] == pytest.approx(suggestions.bounds["x"][1], rel=0.02)  # the largest signal
    assert best.worst is not None
    name, before, after = best.worst
    assert name == "c1"
    assert best.information == pytest.approx(math.log(before / after), rel=1e-6)  # 1/2 ln of the ratio of variances
    assert "about the constants" in str(suggestions)


@pytest.mark.filterwarnings("error")
def test_a_candidate_that_the_data_have_excluded_is_said_to_be() -> None:
    distances = np.array([[0.0, 900.0], [900.0, 0.0]])
    assert expected_gain(distances, [1.0, 0.0], np.ones((2, 2))).information == 0.0
    times = np.linspace(0.0, 2.0, 150)
    x = 2.0 * np.exp(-0.5 * times) + 1e-5 * np.random.default_rng(3).standard_normal(150)
    data = measured({"x": "-0.5*x"}, [(times, {"x": x})], 1e-5)
    suggestions = suggest(Result.of(data), DesignRequest({}, rivals=[{"x": "-0.2"}]))
    assert suggestions.purpose == "precision"
    assert suggestions.reason == "the data already exclude all but one of 2 candidates"


def test_a_model_without_constants_and_candidates_is_refused() -> None:
    known = measured({"x": "-x"}, [(TIMES, {"x": 2.0 * np.exp(-TIMES) + 0.01 * NOISE})], 0.01)
    known["equations"][0]["origin"] = "known"
    with pytest.raises(UsageError, match="an experiment gives no information"):
        suggest(Result.of(known), DesignRequest({}))


def test_candidates_that_foretell_the_same_are_not_told_apart() -> None:
    suggestions = suggest(Result.of(FOUND), DesignRequest({"x": (0.01, 0.02)}))
    assert suggestions.purpose == "precision"
    assert suggestions.reason == "all 2 candidates predict the same outcomes within the bounds"


def test_rivals_that_are_given_are_candidates() -> None:
    suggestions = suggest(Result.of(LINEAR), DesignRequest({"x": (0.5, 9.0)}, rivals=[{"dx/dt": "-0.7"}]))
    assert sorted(candidate.origin for candidate in suggestions.candidates) == ["given", "shown"]
    assert suggestions.purpose == "discrimination"


@pytest.mark.slow
@pytest.mark.parametrize("rival", ["-0.5*x*(1 + 0.2)/(1 + 0.2*x)", "-0.4*x - x*0.1/(1 + x/3)"])
def test_constants_of_a_rival_that_data_without_noise_do_not_tell_apart_are_no_error(rival: str) -> None:
    clean = measured({"x": "-0.5*x"}, [(TIMES, {"x": 2.0 * np.exp(-0.5 * TIMES)})], 1e-12)
    suggestions = suggest(Result.of(clean), DesignRequest(WIDE, rivals=[{"x": rival}]))
    assert sorted(candidate.origin for candidate in suggestions.candidates) == ["given", "shown"]


def test_a_quotient_has_rivals_without_its_pole() -> None:
    y = np.array([(4.0 + 2.0 * time) ** 0.5 for time in TIMES])  # dx/dt = 1/x
    suggestions = suggest(
        Result.of(measured({"x": "1.02/x"}, [(TIMES, {"x": y + 0.01 * NOISE})], 0.01)), DesignRequest({"x": (0.2, 3.0)})
    )
    origins = {candidate.origin for candidate in suggestions.candidates}
    assert origins <= {"shown", "denominator"}
    assert "shown" in origins


def test_denominators_are_made_without_the_constant_that_they_have() -> None:
    result = measured({"x": "-x*y/(2 + y)", "y": "1/x"}, [(TIMES, {"x": 3.0 - TIMES, "y": 1.0 + TIMES})], 0.01)
    measured_rows, equations = measured_of(Result.of(result)), equations_of(Result.of(result))
    made = [
        [to_infix(pole, ("x", "y"), digits=3) for pole in without_poles(program, equations, measured_rows)]
        for program in equations.programs
    ]
    assert len(made[0]) == 1
    assert "y**2" in made[0][0].replace("y*y", "y**2")
    assert len(made[1]) == 2


def test_constant_inputs_are_chosen_within_their_bounds() -> None:
    x = 1.0 - 0.5 * np.exp(-0.5 * TIMES) + 0.01 * NOISE
    result = measured({"x": "u - 0.5*x"}, [(TIMES, {"x": x, "u": np.full(12, 0.5)})], 0.01, ("u",))
    bounds = {"x": (0.0, 3.0), "u": (0.0, 2.0)}
    suggestions = suggest(Result.of(result), DesignRequest(bounds, rivals=[{"x": "0.5 - 0.5*x*u"}]))
    assert all(0.0 <= experiment.inputs["u"] <= 2.0 for experiment in suggestions.experiments)
    assert suggestions.bounds == bounds


def test_an_input_that_is_the_time_goes_on_and_is_not_chosen() -> None:
    times = 3.0 + TIMES
    x = 2.0 - 0.3 * (times**2 - 9.0) / 2.0 + 0.01 * NOISE
    result = measured({"x": "-0.3*t"}, [(times, {"x": x, "t": times})], 0.01, ("t",))
    suggestions = suggest(Result.of(result), DesignRequest({"x": (0.5, 2.0)}, rivals=[{"x": "-1.2 + 0*t"}]))
    assert set(suggestions.bounds) == {"x"}
    first = suggestions.experiments[0]
    assert (first.times[0], first.times[-1]) == (3.0, pytest.approx(5.0))
    assert first.inputs == {}


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"cost": "money"}, "the cost must be trajectory, duration or samples, but 'money'"),
        ({"duration": -1.0}, "duration of an experiment must be above 0"),
        ({"samples": 1}, "2 to 2000 samples, but 1"),
        ({"count": 0}, "count of suggestions must be 1 to 20"),
        ({"bounds": {"z": (0.0, 1.0)}}, "the bounds have 'z', but an experiment has x"),
        ({"bounds": {"x": (2.0, 1.0)}}, "not an interval; give LOWER:UPPER"),
        ({"rivals": [{"z": "1"}]}, "an alternative model has an equation of 'z'"),
    ],
)
def test_what_does_not_fit_is_a_sentence(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(UsageError, match=sentence):
        suggest(Result.of(FOUND), DesignRequest(**({"bounds": WIDE} | changes)))


def test_the_discrepancy_is_that_of_a_difference_its_errors_cannot_explain() -> None:
    along = np.array([[[1.0]], [[0.0]]])
    still = DesignPrediction(np.array([[0.0], [0.0]]), 0.0 * along, 2)
    sure = DesignPrediction(np.array([[3.0], [4.0]]), 0.0 * along, 2)
    unsure = DesignPrediction(np.array([[3.0], [4.0]]), 1e6 * along, 2)
    assert discrepancy(still, sure) == pytest.approx(25.0 / 2.0)
    assert discrepancy(still, unsure) == pytest.approx(16.0 / 2.0, rel=1e-6)
    assert discrepancy(still, DesignPrediction(sure.values, sure.spread, 1)) == pytest.approx(9.0 / 2.0)


def test_information_is_none_of_the_same_and_all_of_what_is_far_apart() -> None:
    apart = np.array([[0.0, 50.0], [50.0, 0.0]])
    useful = useful_evidence([0.0, 13.0])
    np.testing.assert_allclose(useful, [[3.0 + 6.0**0.5 * 2.0] * 2, [16.0 + 32.0**0.5 * 2.0, 3.0 + 6.0**0.5 * 2.0]])
    assert expected_gain(np.zeros((2, 2)), [0.5, 0.5], useful).information == pytest.approx(0.0)
    assert expected_gain(apart, [0.5, 0.5], useful).information == pytest.approx(math.log(2.0))
    assert expected_gain(apart, [0.5, 0.5], useful).evidence == pytest.approx(4.0 * 50.0)
    assert expected_gain(apart, [0.5, 0.5], useful).worth == pytest.approx(0.5 * (useful[0, 1] + useful[1, 0]))


def test_information_about_constants_leaves_out_what_an_initial_state_explains() -> None:
    spread = np.array([[[2.0, 0.0]], [[0.0, 1e6]]])  # the second row tells the initial state alone
    gain, left = precision(DesignPrediction(np.zeros((2, 1)), spread, 2), 1)
    assert gain.information == pytest.approx(0.5 * math.log(5.0))
    np.testing.assert_allclose(left, [[0.2]])
