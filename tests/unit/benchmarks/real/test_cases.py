"""Jobs of real measurements are made from files that are not part of the project."""

from pathlib import Path

from benchmarks.real.__main__ import lines
from benchmarks.real.cases import CASES, Case


def test_a_half_of_a_record_keeps_its_times_and_starts(tmp_path: Path) -> None:
    rows = [f"{0.1 * index:.1f},{index}" for index in range(40)]
    (tmp_path / "swing.csv").write_text("t,theta\n" + "\n".join([*rows[:30], ",", *rows[30:]]) + "\n")
    whole = Case("whole", "swing.csv").table(tmp_path)
    half = Case("half", "swing.csv", share=(0.5, 1.0)).table(tmp_path)
    assert half.columns.tolist() == whole.columns[:, 20:].tolist()
    assert (whole.starts, half.starts) == ((0, 30), (0, 10))
    assert half.line_of_row.tolist() == whole.line_of_row[20:].tolist()


def test_cases_have_names_of_their_own_and_seeds() -> None:
    assert len({case.name for case in CASES}) == len(CASES)
    assert all(case.config(7, None).seed == 7 for case in CASES)


def test_a_case_that_failed_is_said() -> None:
    assert lines({"case": "swing", "failure": "there is no file", "seconds": 0.4}) == ["swing: there is no file (0 s)"]
