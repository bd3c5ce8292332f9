"""Profile likelihoods against closed forms, and what they say of constants together."""

from typing import Any

import numpy as np
import pytest

from atoll.api.model import Model
from atoll.experiments.designs import DesignRequest
from atoll.experiments.fits import measured_of
from atoll.experiments.identifiability import Identifiability, identify, relation_of
from atoll.experiments.suggestion import suggest
from atoll_coordinator.result.result import Result
from atoll_core.errors import UsageError
from tests.unit.library.experiments.made import measured

TIMES = np.linspace(0.0, 5.0, 20)
NOISE = np.random.default_rng(1).standard_normal(20)
DECAY = 3.0 * np.exp(-0.6 * TIMES) + 0.02 * NOISE


def of_decay(text: str) -> Identifiability:
    return identify(Result.of(measured({"x": text}, [(TIMES, {"x": DECAY})], 0.02)))


def test_the_profile_of_a_linear_model_is_its_quadratic() -> None:
    x = 1.0 + 2.0 * TIMES + 0.3 * NOISE
    identified = identify(Result.of(measured({"x": "1.8"}, [(TIMES, {"x": x})], 0.3)))
    design = np.stack([np.ones(20), TIMES], axis=1)
    solution, squares, *_ = np.linalg.lstsq(design, x, rcond=None)
    error = float(np.sqrt(squares[0] / 18.0 * np.linalg.inv(design.T @ design)[1, 1]))
    slope = identified["c1"]
    assert identified.freedom == 18.0
    assert identified.quantile == pytest.approx(2.1009, abs=1e-4)  # Student's t with 18 degrees of freedom
    assert slope.estimate == pytest.approx(solution[1], rel=1e-6)
    assert slope.std_error == pytest.approx(error, rel=1e-5)
    np.testing.assert_allclose(slope.deviances, ((slope.values - slope.estimate) / error) ** 2, atol=1e-3)
    np.testing.assert_allclose(slope.interval, slope.quadratic, rtol=1e-4)
    assert slope.verdict == "determined"
    assert identified.sloppy == ()


@pytest.mark.parametrize(
    ("text", "relation"), [("-1.5*(0.4*x)", "c1*c2"), ("0.2*x - 0.8*x", "c1 - c2"), ("-1.5*x/2.5", "c1/c2")]
)
def test_of_a_decay_one_combination_is_determined(text: str, relation: str) -> None:
    identified = of_decay(text)
    assert [constant.verdict for constant in identified.constants] == ["structurally non-identifiable"] * 2
    assert [relation.words for relation in identified.sloppy] == [
        f"only {relation} is determined, not c1 and c2 separately"
    ]
    assert relation in str(identified)


def test_saturation_that_was_not_reached_is_open_to_one_side() -> None:
    x = 0.5 * np.exp(-0.2 * TIMES) + 0.005 * NOISE
    identified = identify(Result.of(measured({"x": "-2*x/(10 + x)"}, [(TIMES, {"x": x})], 0.005)))
    fastest, half = identified["c1"], identified["c2"]
    assert (fastest.verdict, half.verdict) == ("open below", "open above")  # the text has -2
    assert (fastest.interval[0], half.interval[1]) == (-np.inf, np.inf)
    assert 0.0 < half.interval[0] < half.estimate
    assert half.deviances[-1] < identified.quantile**2
    assert half.sentence.endswith(f"open above: at least {half.interval[0]:.4g}")
    assert identified.sloppy[0].words == "only c1/c2 is determined, not c1 and c2 separately"


def test_a_minus_in_the_text_turns_an_interval_round() -> None:
    identified = of_decay("-0.5*x")
    constant = identified["c1"]
    assert constant.estimate < 0.0
    assert constant.interval[0] < constant.estimate < constant.interval[1] < 0.0
    assert np.all(np.diff(constant.values) > 0.0)


def test_factors_of_one_are_constants_that_have_no_number() -> None:
    identified = of_decay("-x")
    (only,) = identified.constants
    assert (only.name, only.is_written) == ("1 of x (dx)", False)
    assert abs(only.estimate - 0.6) < 0.02


def test_inputs_act_along_the_profile() -> None:
    u = np.sin(TIMES)
    course = np.array([1.0 + (1.0 - np.cos(time)) * 0.7 for time in TIMES])
    identified = identify(
        Result.of(measured({"x": "0.5*u"}, [(TIMES, {"x": course + 0.01 * NOISE, "u": u})], 0.01, ("u",)))
    )
    low, high = identified["c1"].interval
    assert low < 0.7 < high < low + 0.1


def test_errors_that_go_together_widen_intervals() -> None:
    course = [(TIMES, {"x": DECAY})]
    errors = {"errors": {"independent_rows": 5.0, "piece": None}, "sd": 0.02, "relative": 0.02, "method": "loess"}
    narrow = of_decay("-0.5*x")["c1"].std_error
    wide = identify(Result.of(measured({"x": "-0.5*x"}, course, 0.02) | {"noise": {"x": errors}}))["c1"].std_error
    assert wide == pytest.approx(2.0 * narrow, rel=1e-3)


def test_rows_that_a_result_does_not_list_count_as_well() -> None:
    full = measured({"x": "-0.5*x"}, [(TIMES, {"x": DECAY})], 0.02)
    full["data"]["trajectories"][0]["rows"] = 80
    identified = identify(Result.of(full))
    assert "20 of 80 rows" in identified.source
    assert identified["c1"].std_error == pytest.approx(0.5 * of_decay("-0.5*x")["c1"].std_error, rel=0.05)


def test_an_interval_of_the_model_is_by_its_profile_where_that_is_asked_for() -> None:
    result = measured({"x": "-0.5*x"}, [(TIMES, {"x": DECAY})], 0.02)
    model = Model(result)
    assert model.conf_int() == {"c1": None}
    assert model.conf_int(method="profile") == {"c1": model.profile()["c1"].interval}
    assert model.conf_int(0.5, "profile")["c1"] != model.conf_int(0.95, "profile")["c1"]
    given = {"t": TIMES, "x": DECAY}
    assert model.identifiability(data=given).source == "the given data"
    with pytest.raises(UsageError, match="'stderr' or 'profile'"):
        model.conf_int(method="bayes")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"data": {"digest": "ab"}}, "has no measurements; give them as data"),
        ({"system": {"kind": "regression"}}, "a regression without time; only models of measured trajectories"),
        ({"system": {"kind": "process"}}, "a stochastic process; only models"),
    ],
)
def test_what_cannot_be_profiled_is_a_sentence(changes: dict[str, object], sentence: str) -> None:
    with pytest.raises(UsageError, match=sentence):
        identify(Result.of(measured({"x": "-0.5*x"}, [(TIMES, {"x": DECAY})], 0.02) | changes))


def of_groups() -> dict[str, Any]:
    """Return a result of decays whose rate is 0.6 in group a and 1.2 in group b."""
    fast = 3.0 * np.exp(-1.2 * TIMES) + 0.02 * NOISE
    identified = measured({"x": "-0.9*x"}, [(TIMES, {"x": DECAY}), (TIMES, {"x": fast})], 0.02)
    identified["config"] = {"data": {"group": "strain"}}
    part = {"program": None, "constants": []}
    identified["equations"][0]["groups"] = [
        part | {"group": name, "expression": f"-{rate}*x"} for name, rate in (("a", 0.6), ("b", 1.2))
    ]
    identified["groups"] = [
        {"group": name, "trajectories": [number], "covariance": None} for name, number in (("a", "1"), ("b", "2"))
    ]
    return identified


def table_of_groups(*names: str) -> dict[str, Any]:
    rates = {"a": 0.6, "b": 1.2, "c": 2.0}
    x = np.concatenate([3.0 * np.exp(-rates[name] * TIMES) + 0.02 * NOISE for name in names])
    return {"strain": np.repeat(names, len(TIMES)), "t": np.tile(TIMES, len(names)), "x": x}


def test_constants_that_differ_between_groups_cannot_be_profiled_together() -> None:
    with pytest.raises(UsageError, match=r"differ between groups of trajectories.*give the data of one group"):
        identify(Result.of(of_groups()))


@pytest.mark.parametrize("names", ["abc", "b"])
def test_of_data_those_of_the_chosen_group_are_used(names: str) -> None:
    identified = Model(of_groups()).of_group("b").identifiability(data=table_of_groups(*names))
    assert identified["c1"].estimate == pytest.approx(-1.2, rel=0.05)
    assert identified["c1"].verdict == "determined"


def test_a_group_has_its_share_of_the_independent_rows() -> None:
    contents = of_groups()
    errors = {"errors": {"independent_rows": 10.0, "piece": None}, "sd": 0.02, "relative": 0.02, "method": "loess"}
    chosen = Model(contents | {"noise": {"x": errors}}).of_group("b")
    assert measured_of(chosen.result).independent.tolist() == pytest.approx([5.0])


def test_data_without_the_chosen_group_are_refused() -> None:
    chosen = Model(of_groups()).of_group("b")
    with pytest.raises(UsageError, match="no rows of group 'b', only of a, c"):
        chosen.identifiability(data=table_of_groups("a", "c"))
    with pytest.raises(UsageError, match="no column 'strain'"):
        chosen.identifiability(data={"t": TIMES, "x": DECAY})


def test_of_trajectories_the_chosen_one_is_used() -> None:
    contents = of_groups()
    contents["config"] = {"data": {"trajectory": "run", "per_trajectory": True}}
    for number, group in enumerate(contents["groups"], start=1):
        group["group"] = contents["equations"][0]["groups"][number - 1]["group"] = str(number)
    chosen = Model(contents).of_group(2)
    data = table_of_groups("a", "b")
    data["run"] = np.where(data.pop("strain") == "a", 1.0, 2.0)
    assert chosen.identifiability(data=data)["c1"].estimate == pytest.approx(-1.2, rel=0.05)
    with pytest.raises(UsageError, match="no rows of group '2', only of 3, 4"):
        chosen.identifiability(data=data | {"run": data["run"] + 2.0})


def test_a_profile_ends_at_a_bound_of_its_constant() -> None:
    free = of_decay("-0.5*x")["c1"]
    bound = free.estimate - 0.5 * free.std_error
    result = measured({"x": "-0.5*x"}, [(TIMES, {"x": DECAY})], 0.02)
    result["equations"][0]["constants"] = [{"value": -0.5, "bounds": [bound, None]}]
    identified = identify(Result.of(result))["c1"]
    assert identified.interval[0] == pytest.approx(bound, rel=1e-9)
    assert identified.interval[1] == pytest.approx(free.interval[1], rel=1e-4)
    assert identified.is_cut == (True, False)
    assert identified.values.min() >= bound


def test_constants_stand_in_the_order_of_the_text_and_ends_can_be_told_apart() -> None:
    y = 2.0 + TIMES + 1e-6 * NOISE
    text = {"x": "-3*x + 2*y", "y": "1.00000001"}
    x = (2.0 / 3.0) * (2.0 - 1.0 / 3.0 + TIMES) + np.exp(-3.0 * TIMES) + 1e-6 * NOISE
    identified = identify(Result.of(measured(text, [(TIMES, {"x": x, "y": y})], 1e-6)))
    assert [constant.name for constant in identified.constants] == ["c1", "c2", "c3"]
    assert [round(constant.estimate) for constant in identified.constants] == [-3, 2, 1]
    low, high = identified["c3"].sentence.partition(": ")[2].split(" to ")
    assert low != high
    largest = identified.directions[-1].weights
    assert largest.shape == (3,)


def test_a_trajectory_in_pieces_lasts_as_long_as_it_was_measured() -> None:
    times = np.linspace(0.0, 5.0, 60)
    noise = {"x": {"sd": 0.02, "relative": 0.02, "method": "loess", "errors": {"piece": 20}}}
    x = 3.0 * np.exp(-0.6 * times) + 0.02 * np.random.default_rng(4).standard_normal(60)
    result = measured({"x": "-0.5*x"}, [(times, {"x": x})], 0.02) | {"noise": noise}
    assert identify(Result.of(result)).piece == 20
    first = suggest(Result.of(result), DesignRequest({})).experiments[0]
    assert (len(first.times), first.times[-1]) == (60, pytest.approx(5.0))


def test_relations_are_found_along_a_path() -> None:
    a = np.geomspace(0.5, 8.0, 9)
    assert relation_of(np.stack([a, 3.0 / a], 1), ("a", "b")) == "a*b"
    assert relation_of(np.stack([a, 3.0 * a**2], 1), ("a", "b")) == "a**2/b"
    assert relation_of(np.stack([a, 20.0 - a], 1), ("a", "b")) == "a + b"
    assert relation_of(np.stack([a, 20.0 - 0.5 * a], 1), ("a", "b")) == "0.5*a + b"
    assert relation_of(np.stack([a, np.sin(7.0 * a)], 1), ("a", "b")) is None
