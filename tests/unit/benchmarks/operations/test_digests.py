"""The ways to search whose digests must agree, and how they are compared."""

from pathlib import Path

from benchmarks.operations.digests import Way, compared, ways

CACHE = Path("kernels")


def result(digest):
    return {"digest": digest, "point_evaluations": 1000}


def test_all_ways_are_in_groups_of_at_least_two():
    islands = [way.islands for way in ways(CACHE)]
    assert all(islands.count(number) > 1 for number in islands)


def test_one_island_per_worker_and_more_workers_than_islands_are_among_them():
    numbers = {(way.islands, way.workers) for way in ways(CACHE)}
    assert any(islands == workers > 1 for islands, workers in numbers)
    assert any(workers > 2 * islands for islands, workers in numbers)


def test_kernels_of_another_processor_have_a_cache_of_their_own():
    (generic,) = [dict(way.environment) for way in ways(CACHE) if "NUMBA_CPU_NAME" in dict(way.environment)]
    assert generic["ATOLL_KERNEL_CACHE"] == "kernels"


def test_only_digests_of_as_many_islands_are_compared(capsys):
    many = [Way("a", 8, 1), Way("b", 8, 2), Way("c", 2, 1), Way("d", 2, 2)]
    digests = {"a": "one", "b": "other", "c": "two", "d": "two"}
    outcomes = compared("some system", many, lambda way: result(digests[way.name]))
    assert [outcome.is_same for outcome in outcomes] == [True, False, True, True]
    assert "b: other DIFFERS" in capsys.readouterr().err
