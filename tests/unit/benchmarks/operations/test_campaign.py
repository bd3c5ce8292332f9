"""The file of a campaign that was killed, and the growth of its memory."""

import json
import math
from pathlib import Path

import pytest

from benchmarks.operations.campaign import Memory, names_in, slope, tables_of


def test_a_line_that_a_killed_program_did_not_complete_is_cut_off(tmp_path: Path) -> None:
    file = tmp_path / "results.jsonl"
    assert names_in(file) == []
    whole = json.dumps({"name": "decay 0"}) + "\n"
    file.write_text(whole + '{"name": "grow')
    assert names_in(file) == ["decay 0"]
    assert file.read_text() == whole


def test_the_growth_of_memory_is_the_slope_of_the_second_half() -> None:
    memory = [Memory(tables, 10**9 // tables if tables < 50 else 1000 * tables, 0, 0) for tables in range(1, 101)]
    assert slope(memory, "caller") == pytest.approx(1000.0)
    assert slope(memory, "computing") == 0.0
    assert math.isnan(slope(memory[:2], "caller"))


def test_a_table_depends_only_on_its_number() -> None:
    few, many = dict(tables_of(3)), dict(tables_of(5))
    assert len(many) == 5
    for name, data in few.items():
        assert data.keys() == many[name].keys()
        assert all((many[name][column] == values).all() for column, values in data.items())
