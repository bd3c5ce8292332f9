"""Sixty jobs by two revisions: what is compared, what is gone on with, and what the list holds."""

from dataclasses import replace
from pathlib import Path

import pytest

from atoll_core.errors import UsageError
from benchmarks.operations.same_results import Found, Side, compare, journal_of, summed
from benchmarks.operations.small_jobs import JOBS

LINE = "2 k point evaluations in 0.6 s of search, seed 0"
RESULT = {"digest": "a", "seconds": 1.0, "equations": [{"size": 1}]}
FOUND = Found("lv1", "given", "code", 0, ["dx/dt = x", LINE], ["read as text"], RESULT)


def test_digests_results_printed_lines_exit_codes_and_what_was_given_are_compared() -> None:
    result = {"digest": "b", "equations": [{"size": 2}]}
    other = Found("lv1", "other", "new code", 4, ["dx/dt = y", LINE], ["read"], result)
    compared = [difference.place for difference in compare({"lv1": FOUND}, {"lv1": other})["lv1"]]
    assert compared[:5] == ["digest", "given", "exit_code", "printed[0]", "messages[0]"]
    assert compared[5:] == ["result.digest", "result.equations[0].size"]


def test_a_job_that_the_other_side_does_not_have_differs() -> None:
    comparison = compare({"lv1": FOUND, "lv2": FOUND}, {"lv1": FOUND})
    assert [bool(place) for place in comparison.values()] == [False, True]
    assert summed(comparison, 5).splitlines()[-1] == "1 of 2 jobs differ, 1 of them in their digests"


def test_a_record_is_gone_on_with_by_the_same_code_only(tmp_path: Path) -> None:
    side, path = Side(tmp_path / "coordinator", "code", tmp_path), tmp_path / "found.jsonl"
    journal_of(side, path, []).add(FOUND)
    assert journal_of(side, path, []).outcomes == {"lv1": FOUND}
    with pytest.raises(UsageError, match="another state of the code"):
        journal_of(replace(side, sources="new code"), path, [])


def test_no_job_ends_by_the_clock() -> None:
    assert not [name for name, words in JOBS.items() if "--max-time" in words]


def test_what_was_given_depends_on_the_bytes_of_files(tmp_path: Path) -> None:
    side = Side(tmp_path / "coordinator", "code", tmp_path)
    (tmp_path / "lv1.csv").write_text("label,x,y\n", "utf-8")
    before = side.given("label lv1")
    assert before != side.given("label lv1, seed 7")
    (tmp_path / "lv1.csv").write_text("label,x,z\n", "utf-8")
    assert before != side.given("label lv1")
