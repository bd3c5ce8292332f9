"""Two JSON values beside each other: what counts as different, and what is left out."""

from typing import Any

import pytest

from benchmarks.operations.differences import (
    Difference,
    differences,
    masked,
    masked_line,
    without_progress,
)


def places(ours: Any, theirs: Any) -> list[str]:
    return [difference.place for difference in differences(ours, theirs)]


def test_places_are_paths_in_the_order_of_ours_with_both_values() -> None:
    unequal = list(differences({"a": [{"b": 1.5}, 2], "c": "x"}, {"a": [{"b": 2.5}, 2], "c": "y"}))
    assert unequal == [Difference("a[0].b", "1.5", "2.5"), Difference("c", '"x"', '"y"')]


@pytest.mark.parametrize(("ours", "theirs"), [(1, 1.0), (1, True), (0.0, -0.0), (None, {}), ([], {}), ({"a": 1}, [1])])
def test_values_that_are_written_in_another_way_differ(ours: Any, theirs: Any) -> None:
    assert places({"a": ours}, {"a": theirs}) == ["a"]


def test_times_and_versions_are_left_out_at_any_depth() -> None:
    result = {"job": "a", "versions": {"numpy": "2"}, "equations": [{"seconds": 1.0, "size": 3}], "search_seconds": 2.0}
    assert masked(result) == {"equations": [{"size": 3}]}


def test_a_printed_line_loses_the_time_of_the_search_alone() -> None:
    line = "1.67 M point evaluations in 0.614 s of search, seed 0"
    assert masked_line(line) == masked_line("1.67 M point evaluations in 1 min 2 s of search, seed 0")
    assert masked_line(line) != masked_line("1.68 M point evaluations in 0.614 s of search, seed 0")
    assert masked_line("time t: 0 to 9.98 s, step 0.02 s") == "time t: 0 to 9.98 s, step 0.02 s"


def test_progress_is_left_out_of_messages() -> None:
    kept = ["read as text with commas", "result in out/result.json", "next: coordinator analyse out"]
    progress = [
        "note: 163 rows are left out",
        "job same-3 running, 4.5 s, 1 worker",
        "  dx/dt  epoch 1  error 5e-13",
        "start-up 5.6 s, total 19.2 s",
    ]
    assert without_progress([kept[0], *progress, *kept[1:]]) == kept
