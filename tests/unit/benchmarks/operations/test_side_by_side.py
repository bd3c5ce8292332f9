"""Two revisions side by side: medians, ratios, and what differs."""

from dataclasses import replace

from benchmarks.operations.side_by_side import Beside, Took, median, shown

TOOK = Took(0.2, 2.0, 3.0, "abc", ("x",), 1000)


def test_medians_are_of_times_and_a_digest_that_changes_is_seen() -> None:
    runs = [replace(TOOK, search=1.0), replace(TOOK, search=5.0, digest="other"), replace(TOOK, search=2.0)]
    medians = median(runs)
    assert (medians.search, medians.command, medians.digest) == (2.0, 2.0, "abc other")
    assert not Beside("a", medians, TOOK).is_same


def test_the_table_has_ratios_and_their_geometric_mean_and_says_what_differs() -> None:
    jobs = [
        Beside("fast", replace(TOOK, search=0.4), TOOK),
        Beside("slow", replace(TOOK, search=0.1, digest="z", equations=("y",)), TOOK),
    ]
    fast, slow, mean = shown(jobs).splitlines()[-3:]
    assert fast.split()[:4] == ["fast", "0.400", "0.200", "2.00"]
    assert fast.split()[-2:] == ["same", "same"]
    assert slow.split()[-2:] == ["DIFFERS", "DIFFER"]
    assert mean.split()[:5] == ["geometric", "mean", "0.200", "0.200", "1.000"]
