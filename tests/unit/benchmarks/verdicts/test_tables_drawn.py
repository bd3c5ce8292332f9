"""Drawn tables: equal seeds give equal tables, which the command line reads, and whose laws are right."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from atoll_coordinator.data.reading.files import read_table
from benchmarks.corpus.cases import LEAST_T
from benchmarks.verdicts.campaign import request, table_of
from benchmarks.verdicts.drawn import Drawn
from benchmarks.verdicts.judging import Key, judge
from benchmarks.verdicts.simulation import Run, least_t

TABLES = [
    Key("few-rows", 0), Key("few-rows", 5), Key("few-rows", 7), Key("targets", 3), Key("targets", 11),
    Key("groups", 0), Key("groups", 1), Key("groups", 5), Key("inputs", 2), Key("inputs", 3), Key("limits", 1),
    Key("strong-noise", 2), Key("rates", 4, "3"),
]  # fmt: skip
LAWLESS_OR_LONG = (Key("targets", 11), Key("groups", 5), Key("inputs", 3))


def result_of(drawn: Drawn, verdict: str = "good") -> dict[str, object]:
    """Return the result of a job that has found the laws."""
    first = next(iter(drawn.laws.values()))
    rows = []
    for variable, law in first.items():
        own = [{"group": group, "expression": laws[variable]} for group, laws in drawn.laws.items() if group]
        rows.append({"variable": variable, "expression": law, "verdict": verdict, "groups": own})
    return {"equations": rows}


@pytest.mark.parametrize("key", TABLES, ids=lambda key: key.title)
def test_a_seed_gives_one_table_that_the_command_line_reads(key: Key, tmp_path: Path) -> None:
    drawn = table_of(key)
    assert drawn.csv() == table_of(key).csv()
    asked = request(drawn.csv(), (*drawn.words, "--max-time", "5"), tmp_path)
    read = read_table(asked.files, asked.config.data)
    assert read.rows == drawn.rows
    for name, values in drawn.columns.items():
        assert read.columns[read.names.index(name)] == pytest.approx(values)


@pytest.mark.parametrize("key", [key for key in TABLES if key not in LAWLESS_OR_LONG], ids=lambda key: key.title)
def test_the_laws_are_right_and_foretell(key: Key) -> None:
    drawn = replace(table_of(key), decide=None)  # which takes seconds
    result = result_of(drawn)
    if key.campaign == "limits":
        result["equations"] += [{"variable": "z", "expression": drawn.laws[""]["x"], "verdict": "good"}]
    for equation in judge(drawn, result):
        assert (equation.form, equation.is_false, equation.is_wrong_beyond) == ("right", False, False)
        assert equation.r2 == pytest.approx(1.0, abs=1e-4)


def test_a_constant_is_known_by_the_errors_and_the_rows() -> None:
    run = Run({"k1": 0.5}, (1.0,), np.linspace(0.0, 4.0, 9))
    small, large = (least_t({"x": "-k1*x"}, [run], {"x": error})["x"] for error in (0.01, 0.02))
    assert small == pytest.approx(2.0 * large)
    times, decay = run.times, np.exp(-0.5 * run.times)
    effects = np.column_stack([-0.5 * times * decay, decay]) / 0.01
    assert small == pytest.approx(1.0 / np.sqrt(np.linalg.inv(effects.T @ effects)[0, 0]), rel=1e-2)
    bound = least_t({"x": "k1*x*(1.0 - k2)"}, [Run({"k1": 0.5, "k2": 2.0}, (1.0,), times)], {"x": 0.01})
    assert bound["x"] < LEAST_T < small
