"""The benchmark of intervals counts what it says, on one seed."""

from benchmarks.experiments import coverage


def test_intervals_are_counted_against_the_truth() -> None:
    name = "decay to a rest, 7 rows, 20 %"
    assert [row[1] for row in coverage.rows([3], [name])] == ["c1", "c2"]
    counts, failed = coverage.count(coverage.CASES[name], [3])
    assert failed == 0
    assert counts["c1"].seeds == 1
