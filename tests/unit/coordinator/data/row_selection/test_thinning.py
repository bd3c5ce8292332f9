"""Many rows are thinned for the search alone, and quick passages keep theirs."""

import numpy as np

from atoll_coordinator.data.row_selection.selected_rows import SelectedRows, thin_searched_rows


def selection(rows: list[int]) -> SelectedRows:
    return SelectedRows(rows, [7], (frozenset(),), ((),), ("said",))


def test_few_rows_stay() -> None:
    few = selection(list(range(100)))
    assert thin_searched_rows(few, [np.arange(100.0)], 100) is few


def test_many_rows_become_about_as_many_as_are_allowed_first_and_last_among_them() -> None:
    state = np.sin(np.linspace(0.0, 20.0, 10_000))
    thinned = thin_searched_rows(selection(list(range(10_000))), [state], 500)
    assert 400 <= len(thinned.searched) <= 500
    assert (thinned.searched[0], thinned.searched[-1]) == (0, 9_999)
    assert max(np.diff(thinned.searched)) <= 41
    assert thinned.held_out == [7]
    assert "of 10000 rows" in thinned.warnings[-1]


def test_a_jump_of_a_few_rows_keeps_them() -> None:
    state = np.concatenate([np.zeros(5_000), np.linspace(0.0, 1.0, 20), np.ones(5_000)])
    kept = set(thin_searched_rows(selection(list(range(len(state)))), [state], 100).searched)
    assert len(kept & set(range(5_000, 5_020))) >= 18


def test_a_state_that_rests_leaves_the_rows_even() -> None:
    kept = thin_searched_rows(selection(list(range(0, 4_000, 2))), [np.ones(4_000)], 200).searched
    assert set(np.diff(kept)) <= {20, 22}
