"""Exports of models with hidden states: observed columns are computed, and given initial values are not estimated."""

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import atoll
from atoll.export.formats import LANGUAGES
from tests.unit.library.experiments.made import two_compartments
from tests.unit.library.export.exported import run_python


def model(**changes: Any) -> atoll.Model:
    return atoll.Model(two_compartments(**changes))


def test_python_computes_the_observed_columns() -> None:
    exported = run_python(model().export("python"))
    assert exported["PARAMETERS"]["V"] == 2.1
    np.testing.assert_allclose(exported["observe"](0.0, np.array([4.2, 1.0])), [2.0])
    other = {**exported["PARAMETERS"], "V": 4.2}
    np.testing.assert_allclose(exported["observe"](0.0, np.array([4.2, 1.0]), other), [1.0])


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("c", "column[0] = c/V; // column y"),
        ("julia", "push!(equations, y ~ c/V)"),
        ("matlab", "c/V; % column y"),
        ("modelica", "  y = c/V;"),
        ("xppaut", "aux y=c/V"),
        ("sbml", '<assignmentRule variable="y">'),
        ("latex", r"y &= \frac{c}{V}"),
        ("sympy", "observations = {'y': sympy.parse_expr('c/V', local_dict=symbols)}"),
    ],
)
def test_every_format_has_the_observed_columns(name: str, line: str) -> None:
    assert line in model().export(name)


def test_models_without_observed_columns_are_exported_as_before() -> None:
    plain = two_compartments() | {"observations": [], "hidden": []}
    for name in LANGUAGES:
        text = atoll.Model(plain).export(name)
        assert "observe(" not in text
        assert not any(word in text for word in ("assignmentRule", "push!", "aux "))


def test_petab_measures_the_observed_columns_and_estimates_no_given_initial_value(tmp_path: Path) -> None:
    model(dose={"lower": 1.0, "upper": 50.0}).to_petab(tmp_path)

    def rows(name: str) -> list[dict[str, str]]:
        return [*csv.DictReader((tmp_path / f"{name}.tsv").read_text().splitlines(), delimiter="\t")]

    assert [(row["observableId"], row["observableFormula"]) for row in rows("observables")] == [("observable_y", "y")]
    assert {row["observableId"] for row in rows("measurements")} == {"observable_y"}
    assert len(rows("measurements")) == 60
    parameters = {row["parameterId"]: row for row in rows("parameters")}
    assert [*parameters] == ["k10", "k12", "k21", "V", "start_c_1", "start_p_1", "sd_y"]
    dose, other = parameters["start_c_1"], parameters["start_p_1"]
    assert (float(dose["lowerBound"]), float(dose["upperBound"]), dose["estimate"]) == (1.0, 50.0, "1")
    assert (float(other["nominalValue"]), other["estimate"]) == (0.0, "0")
    assert float(other["lowerBound"]) < 0.0 < float(other["upperBound"])
