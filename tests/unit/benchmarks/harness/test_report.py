"""What the benchmarks of searches print and write."""

import argparse
import dataclasses
import json

import pytest

from atoll_core.errors import DataError
from benchmarks.harness.command_line import plain_errors, seeds
from benchmarks.harness.report import Report
from tests.unit.benchmarks.judging.verdicts import VERDICT

MISS = dataclasses.replace(VERDICT, found=False, exact=False, reason="a term is missing: v", seconds=2.0, seed=1)


@pytest.mark.parametrize(("text", "numbers"), [("0-2", [0, 1, 2]), ("7", [7]), ("0,2,5-6", [0, 2, 5, 6])])
def test_seeds_are_numbers_and_ranges(text, numbers):
    assert seeds(text) == numbers


@pytest.mark.parametrize("text", ["", "a", "1-", "-1", "1,,2"])
def test_other_seeds_are_refused(text):
    with pytest.raises(argparse.ArgumentTypeError, match="numbers such as"):
        seeds(text)


def test_misses_are_listed_and_counted(capsys):
    report = Report("seven", ["--seeds", "0-1"], None)
    report.add([VERDICT])
    report.add([MISS])
    report.show()
    printed = capsys.readouterr()
    assert "1 of 2 found" in printed.out
    assert "glider seed 1 dv/dt: converged" in printed.out
    assert "missed: glider seed 1" in printed.err


def test_the_file_holds_all_figures_and_the_machine(tmp_path, capsys):
    report = Report("seven", [], tmp_path / "new" / "figures.json")
    report.add([VERDICT, MISS])
    contents = json.loads((tmp_path / "new" / "figures.json").read_text("utf-8"))
    assert [each["found"] for each in contents["verdicts"]] == [True, False]
    assert contents["machine"]["cores"] >= 1
    assert contents["benchmark"] == "seven"
    capsys.readouterr()


def test_an_error_for_a_person_is_a_sentence_and_its_exit_code(capsys):
    with pytest.raises(SystemExit) as ended, plain_errors("benchmarks.paper.seven"):
        raise DataError("there are no data")
    assert ended.value.code == 2
    assert capsys.readouterr().err == "benchmarks.paper.seven: there are no data\n"
