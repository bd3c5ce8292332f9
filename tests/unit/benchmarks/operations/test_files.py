"""Drawn files lose nothing silently; the first of those that ``make soak`` draws by the thousand."""

from collections import Counter

import pytest

from benchmarks.operations.files import main, play


@pytest.mark.parametrize("first", [0, 40, 80])
def test_drawn_files_are_read_or_refused_and_what_is_left_out_is_named(first: int) -> None:
    outcomes = [play(seed) for seed in range(first, first + 40)]
    assert [outcome for outcome in outcomes if outcome.end in ("lost", "broke")] == []
    counts = Counter(outcome.end for outcome in outcomes if "damaged" not in outcome.how)
    assert counts["read"] > 0.85 * counts.total()


def test_one_case_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--seed", "0"]) == 0
    shown = capsys.readouterr()
    assert shown.err.startswith("0: ")
    assert shown.out.startswith("1 files: ")
