"""Exports of given sides: parameters keep their names and bounds, and numbers of the user's text are no parameters."""

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import atoll
from atoll.export.formats import LANGUAGES, export_model
from tests.unit.library.export.exported import TIMES
from tests.unit.library.model.results import bioreactor


def model() -> atoll.Model:
    part = {"name": "1", "start": {"X": 0.7, "S": 0.9}, "times": TIMES.tolist()}
    return atoll.Model(bioreactor(simulation={"trajectories": [part]}))


def test_python_has_the_parameters_by_name_and_the_same_rates() -> None:
    exported: dict[str, Any] = {"__name__": "exported"}
    exec(model().to_python(), exported)
    assert exported["PARAMETERS"] == {"c1": 0.6, "c2": 2.0, "Y": 0.5}
    growth = 0.9 / (0.6 + 2.0 * 0.9)
    expected = [growth * 0.7 - 0.2 * 0.7, -growth * 0.7 / 0.5 + 0.2 * (3.0 - 0.9)]
    found = exported["rates"](0.0, np.array([0.7, 0.9]), exported["PARAMETERS"])
    np.testing.assert_allclose(found, expected, rtol=1e-14)


@pytest.mark.parametrize("name", sorted(LANGUAGES))
def test_every_language_names_the_parameter_and_keeps_the_numbers(name: str) -> None:
    text = export_model(model(), name)
    assert "Y" in text
    body = "\n".join(line for line in text.splitlines() if "X" in line or "S" in line)
    assert "0.2" in body
    assert "c3" not in text


def test_petab_has_the_bounds_of_the_parameter_and_estimates_it(tmp_path: Path) -> None:
    contents = model().result.as_dict()
    part = {
        "name": "1", "held_out": False, "times": TIMES.tolist(), "inputs": {},
        "measured": {"X": [0.7] * len(TIMES), "S": [0.9 + time for time in TIMES.tolist()]},
    }  # fmt: skip
    contents["data"] = {"trajectories": [part]}
    atoll.Model(contents).to_petab(tmp_path)
    rows = csv.DictReader((tmp_path / "parameters.tsv").read_text().splitlines(), delimiter="\t")
    named = {row["parameterId"]: row for row in rows}
    assert [name for name in named if not name.startswith(("start_", "sd_"))] == ["c1", "c2", "Y"]
    row = named["Y"]
    assert (row["lowerBound"], row["upperBound"], row["nominalValue"], row["estimate"]) == ("0.1", "2.0", "0.5", "1")
