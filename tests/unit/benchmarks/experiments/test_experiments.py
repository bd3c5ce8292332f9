"""The benchmarks of experiments count what they say, on one seed."""

import numpy as np

from benchmarks.experiments import coverage, respiration


def test_intervals_are_counted_against_the_truth() -> None:
    name = "decay to a rest, 7 rows, 20 %"
    _, _, *rows = coverage.lines([3], [name])
    assert [row.split(" | ")[1] for row in rows] == ["c1", "c2"]
    counts, failed = coverage.count(coverage.CASES[name], [3])
    assert failed == 0
    assert counts["c1"].seeds == 1


def test_the_truth_wins_where_the_quotient_has_a_pole() -> None:
    times = np.arange(60) * 0.1
    near, far = (respiration.trajectory(start, times) for start in ((0.3, 20.0), (6.0, 10.0)))
    errors = [0.01, 0.05]
    draws = np.random.default_rng(1).standard_normal((60, 2)) * errors
    assert respiration.lead([(times, far + draws)], errors) < respiration.WON
    assert respiration.lead([(times, far + draws), (times, near + draws)], errors) > respiration.WON
