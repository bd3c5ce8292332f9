"""Known equations beside those that are found."""

import math
from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.refinement import Refinement
from atoll_coordinator.model.result.building import KNOWN, Account, VariableOutcome, build_result, result_digest
from atoll_coordinator.model.result.known_equations import known_entries, warn_of_missing_values
from atoll_core.config import EvolutionConfig, JobConfig, ParameterConfig, PriorConfig
from atoll_core.data.dataset import Dataset, Target
from atoll_core.data.notes import Note
from atoll_core.expression.text.parsing import from_infix
from tests.unit.coordinator.model.result.plain import render_text

X = np.linspace(-2.0, 2.0, 50)
DATASET = Dataset(
    ("x", "y"),
    np.stack([X, 1.0 + X]),
    (Target("x", "dx/dt", 3.0 * X, 0.0, 3.0), Target("y", "dy/dt", -0.1 * X + 0.01, 0.0, 0.5)),
    {"x": "x", "y": "y"},
)


def entries(loss="mae", **known):
    return known_entries(DATASET, JobConfig(prior=PriorConfig(known=known), evolution=EvolutionConfig(loss=loss)))


@pytest.mark.parametrize("loss", ["mae", "rmse"])
def test_a_known_equation_is_measured_by_the_loss_of_the_job(loss):
    entry = entries(loss, y="-x/10")["y"]
    assert entry.error == pytest.approx(0.01)
    assert entry.mse == pytest.approx(1e-4)
    assert entry.program == from_infix("-x/10", DATASET.names).to_bytes()
    assert entry.complexity == 4


def test_a_given_equation_has_the_parameters_that_were_estimated():
    prior = PriorConfig(equations={"x": "a*x"}, parameters={"a": ParameterConfig(lower=0.1, upper=10.0)})
    entry = known_entries(DATASET, JobConfig(prior=prior), (3.0,))["x"]
    assert entry.program == from_infix("3*x", DATASET.names).to_bytes()
    assert entry.error == pytest.approx(0.0, abs=1e-15)


def test_one_without_a_value_everywhere_has_no_finite_error():
    assert entries(y="log(x)")["y"].error == math.inf


def test_one_without_a_value_everywhere_is_warned_of():
    config = JobConfig(prior=PriorConfig(known={"x": "3*x", "y": "log(x)"}))
    prepared = warn_of_missing_values(Preparation(DATASET, None), config)
    assert prepared.dataset.warnings == ("The known equation of 'y' has no finite value on 25 of 50 rows.",)


def result(text="-x/10"):
    entry = entries(y=text)["y"]
    outcomes = [VariableOutcome("x", (), 0), VariableOutcome("y", (entry,), 0, why=KNOWN)]
    return build_result(
        "j", JobConfig(), Preparation(DATASET, None), outcomes, Account("done", 1.0, 1.0)
    ).as_dict(), outcomes


def test_it_stands_in_the_result_with_its_error_and_the_cause():
    equation = result()[0]["equations"][1]
    assert (equation["expression"], equation["why"], equation["epoch"]) == ("-x/10.0", "known", 0)
    assert equation["normalized_error"] == pytest.approx(0.02)
    assert equation["converged"] is False
    assert (equation["generation"], equation["point_evaluations"]) == (None, 0)
    assert [member["selected"] for member in equation["front"]] == [True]
    assert result("0.01 - x/10")[0]["equations"][1]["converged"] is True


def test_an_error_that_is_not_finite_is_null():
    equation = result("log(x)")[0]["equations"][1]
    assert (equation["expression"], equation["error"], equation["converged"]) == ("log(x)", None, False)


def test_the_digest_covers_what_was_searched_alone():
    built, outcomes = result()
    assert built["digest"] == result_digest(outcomes[:1])


def test_without_a_search_it_covers_what_is_known_and_the_data():
    def digest(text):
        outcomes = [replace(outcome, why=KNOWN) for outcome in result(text)[1]]
        built = build_result(
            "j", JobConfig(), Preparation(DATASET, None), outcomes, Account("done", 1.0, 1.0)
        ).as_dict()
        return built["digest"]

    assert digest("-x/10") == digest("-x/10")
    assert len({digest("-x/10"), digest("-x/9"), result_digest([])}) == 3


def test_people_read_that_it_was_known():
    lines = render_text(result()[0]).split("\n")
    assert "dy/dt = -0.1*x" in lines
    assert "    known: error 0.02 of the target's standard deviation" in lines
    assert "    known: error ? of the target's standard deviation" in render_text(result("log(x)")[0]).split("\n")


def test_notes_are_told_by_where_they_were_written():
    """Notes were told by phrases of five sentences, which another sentence could hold as well."""
    note, warning = "Rows are averaged.", "States change little from row to row: means of 3 rows are noisy."
    outcome = VariableOutcome("y", (entries(y="-x/10")["y"],), 0, why=KNOWN)
    dataset = replace(DATASET, warnings=(Note(note), warning))
    model = Refinement(warnings=(Note("Operators were tried."), warning))
    built = build_result(
        "j", JobConfig(), Preparation(dataset, None), [outcome], Account("done", 1.0, 1.0), model
    ).as_dict()
    assert built["warnings"] == [note, warning, "Operators were tried.", warning]
    assert built["notes"] == [note, "Operators were tried."]
    assert f"note: {note}" in render_text(built)
