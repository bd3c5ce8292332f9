"""Drawn files lose nothing silently; the first of those that ``make soak`` draws by the thousand."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.operations import files
from benchmarks.operations.files import main, play


@pytest.mark.parametrize("first", [0, 40, 80])
def test_drawn_files_are_read_or_refused_and_what_is_left_out_is_named(first: int) -> None:
    outcomes = [play(seed) for seed in range(first, first + 40)]
    assert [outcome for outcome in outcomes if outcome.end in ("lost", "broke")] == []
    counts = Counter(outcome.end for outcome in outcomes if "damaged" not in outcome.how)
    assert counts["read"] > 0.85 * counts.total()


def test_values_that_are_not_those_of_the_file_are_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else names that the description of a file happens to have would hide what was read wrongly."""
    draw = files.drawn

    def drawn(seed: int, folder: Path) -> files.Case:
        case = draw(seed, folder)
        return replace(case, values={name: 3.0 * column + 7.0 for name, column in case.values.items()})

    monkeypatch.setattr(files, "drawn", drawn)
    outcomes = [play(seed) for seed in range(60)]
    ends = {outcome.end for outcome in outcomes if "damaged" not in outcome.how}
    assert "lost" in ends
    assert ends <= {"lost", "refused"}, [outcome for outcome in outcomes if outcome.end == "read"]


def test_one_case_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--seed", "0"]) == 0
    shown = capsys.readouterr()
    assert shown.err.startswith("0: ")
    assert shown.out.startswith("1 files: ")
