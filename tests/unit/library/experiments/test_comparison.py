"""Two models beside each other: which describes the data better, and how sure that is, in a sentence."""

from typing import Any

import numpy as np
import pytest

from atoll.api.model import Model
from atoll.experiments.comparison import compare, most_errors
from atoll.experiments.suggestion import certainty_text_of, which_of_two
from atoll_coordinator.result.result import Result
from atoll_core.errors import UsageError
from atoll_core.expression.text.parsing import from_infix
from tests.unit.library.experiments.made import measured
from tests.unit.library.model.results import constant, process_result, result

TIMES = np.linspace(0.0, 4.0, 40)
X = 2.0 * np.exp(-0.5 * TIMES) + 0.01 * np.random.default_rng(2).standard_normal(40)


def decay(text: str = "-0.5*x", value: float = -0.5, **changes: Any) -> dict[str, Any]:
    contents = measured({"x": text}, [(TIMES, {"x": X})], 0.01, **changes)
    contents["equations"][0]["constants"] = [constant(value, 0.01)]
    return contents


@pytest.mark.parametrize(
    ("nats", "sentence"),
    [
        (0.0, "A and B describe the data equally well."),
        (0.5, "The data do not decide between A and B: A is 1.6 times as probable as B (62 to 38 %), if one of"),
        (-2.0, "The data favour B, but do not decide: B is 7.4 times as probable as A (88 to 12 %), if"),
        (5.0, "The data decide for A: A is 100 times as probable as B, if one of them is right."),
        (1e82, "The data decide for A: A is more than a million times as probable as B, if one of them is right."),
        (-np.inf, "The data decide for B: B is more than a million times as probable as A, if one of them is right."),
    ],
)
def test_it_is_said_which_of_two_is_right_and_how_sure_that_is(nats: float, sentence: str) -> None:
    assert which_of_two("A", "B", nats).startswith(sentence)
    assert len(which_of_two("A", "B", nats)) < 150


def test_a_certainty_is_never_rounded_up() -> None:
    assert [certainty_text_of(sure) for sure in (0.5, 0.9896, 0.9989, 1.0)] == [
        "at least 50 %", "at least 98 %", "at least 99 %", "more than 99.9 %",
    ]  # fmt: skip


def test_the_law_is_told_from_what_it_is_not() -> None:
    compared = compare(Result.of(decay()), Result.of(decay("-0.3")), ("law", "other"))
    (on,) = compared.data
    assert on.nats > 10.0
    assert on.longer is not None
    assert on.longer > 0.0
    assert compared.forms == {"dx/dt": "another form"}
    assert "The data decide for A: A is more than a million times as probable as B" in str(compared)
    assert str(compared).startswith("A = law: dx/dt = -0.5*x\nB = other: dx/dt = -0.3\n")
    turned = compare(Result.of(decay("-0.3")), Result.of(decay()))
    assert turned.data[0].nats == pytest.approx(-on.nats, rel=1e-6)


def test_constants_of_one_form_are_compared_by_their_errors() -> None:
    near = compare(Result.of(decay()), Result.of(decay("-0.51*x", -0.51)))
    assert near.forms == {"dx/dt": "the same form; its constants agree within their errors, c1 by 0.71 standard errors"}
    far = compare(Result.of(decay()), Result.of(decay("-0.7*x", -0.7)))
    assert far.forms == {"dx/dt": "the same form; its constants differ, c1 by 14 standard errors"}
    assert far.data[0].sentence == "A and B describe the data equally well."  # once fitted
    assert compare(Result.of(decay()), Result.of(decay())).forms == {"dx/dt": "the same equation"}


@pytest.mark.parametrize(("count", "most"), [(1, 1.96), (2, 2.24), (5, 2.57), (20, 3.02)])
def test_the_largest_of_several_differences_may_be_larger(count: int, most: float) -> None:
    """At 2 standard errors a fifth of equal laws with five constants differed."""
    assert most_errors(count) == pytest.approx(most, abs=0.01)
    differences = np.random.default_rng(0).normal(size=(20_000, count))
    assert np.mean(np.abs(differences).max(axis=1) <= most_errors(count)) == pytest.approx(0.95, abs=0.005)


def test_results_of_different_data_are_compared_on_both() -> None:
    slower = measured({"x": "-0.3"}, [(TIMES, {"x": 2.0 - 0.3 * TIMES + X - 2.0 * np.exp(-0.5 * TIMES)})], 0.01)
    slower["data"]["digest"] = "other"
    compared = compare(Result.of(decay()), Result.of(slower))
    assert [on.source for on in compared.data] == ["1 trajectory of A, 40 rows", "1 trajectory of B, 40 rows"]
    assert compared.data[0].nats > 3.0
    assert compared.data[1].nats < -3.0


def test_candidates_are_models_to_compare_and_python_has_it() -> None:
    contents = decay()
    other = {"expression": "-0.4", "complexity": 1, "nats": 9.0, "origin": "library", "selected": False}
    contents["equations"][0]["candidates"] = [other]
    model = Model(contents)
    compared = model.compare(model.candidates[0])
    assert compared.data[0].nats > 3.0
    assert repr(compared) == str(compared)
    assert compared.as_dict()["A"] == {"name": "the first", "equations": {"dx/dt": "-0.5*x"}}


def test_regressions_are_compared_on_the_rows_that_they_list() -> None:
    def regression(text: str) -> dict[str, Any]:
        contents = result({"y": text}, ("x",))
        contents["symbols"] = {"x": "x"}
        contents["equations"][0] |= {"lhs": "y", "expression": text, "constants": [constant(2.0, 0.1)]}
        del contents["equations"][0]["program"]
        contents["system"] |= {"kind": "regression", "target": "y"}
        x = np.linspace(0.0, 1.0, 30)
        rows = {"variables": {"x": x.tolist()}, "measured": (2.0 * x + 0.01 * np.sin(40.0 * x)).tolist()}
        return contents | {"regression": {"rows": 30, "listed": 30, "fitted": [0.0] * 30, **rows}}

    compared = compare(Result.of(regression("2.0*x")), Result.of(regression("2.0*x*x")))
    assert compared.data[0].nats > 10.0
    assert "decide for A" in compared.data[0].sentence
    assert "residuals y 1.2 % of the standard deviation" in str(compared)


def swinging(order: int) -> Result:
    """Return a law of x of first or second order; the data swing, as only the second order can."""
    x = np.cos(3.0 * TIMES) + 0.01 * np.random.default_rng(4).standard_normal(40)
    contents = measured({"x": "-0.5*x"}, [(TIMES, {"x": x})], 0.01)
    if order == 2:
        names = ["x", "x_dot"]
        program = from_infix("-9.0*x", names).to_bytes().hex()
        contents["equations"][0] |= {"lhs": "d2x/dt2", "expression": "-9.0*x", "program": program}
        contents["symbols"] = {name: name for name in names}
        contents["system"] |= {"order": 2, "velocities": ["x_dot"]}
    return Result.of(contents)


def test_models_with_other_states_are_compared_by_the_same_measured_columns() -> None:
    compared = compare(swinging(2), swinging(1))
    (on,) = compared.data
    assert on.columns == ("x",)
    assert on.nats > 10.0
    assert on.sides[0].residuals["x"] < 0.05 < on.sides[1].residuals["x"]
    assert ", by the measured x:" in str(compared)
    assert "decide for A" in on.sentence
    assert compared.forms == {}
    turned = compare(swinging(1), swinging(2))
    assert turned.data[0].nats < -10.0


def test_an_input_that_the_data_of_the_other_model_lack_is_a_sentence() -> None:
    contents = measured({"x": "-0.5*x*u"}, [(TIMES, {"x": np.exp(-TIMES), "u": np.ones(40)})], 0.01, ("u",))
    with pytest.raises(UsageError, match="has u, but the data of the other model do not"):
        compare(swinging(2), Result.of(contents))


@pytest.mark.parametrize(
    ("other", "sentence"),
    [
        (result({"y": "-y"}), "A has equations of dx/dt and B of dy/dt; compare models of the same quantities"),
        (result({"x": "-x*u"}, ("u",)), "the equation of dx/dt has u, but the data of the other model do not"),
        (process_result(), "compare models of the same quantities"),
    ],
)
def test_what_cannot_be_compared_is_a_sentence(other: dict[str, Any], sentence: str) -> None:
    with pytest.raises(UsageError, match=sentence):
        compare(Result.of(decay()), Result.of(other))
