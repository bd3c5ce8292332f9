"""The ablation of hand-set numbers: which number is changed, and what is counted."""

import pytest

from atoll_coordinator.model import criteria
from atoll_coordinator.settings import SETTINGS
from atoll_core.errors import UsageError
from benchmarks.corpus.ablation import JOBS, Replay, changed, differences, summary


def test_numbers_are_changed_for_a_while_only():
    before = SETTINGS.effort.beam, SETTINGS.smoothing.patience, criteria.SMALLEST_UNCERTAINTY
    with changed({
        "effort.beam": 1, "smoothing.patience": 2, "atoll_coordinator.model.criteria:SMALLEST_UNCERTAINTY": 3.0,
    }):  # fmt: skip
        assert (SETTINGS.effort.beam, SETTINGS.smoothing.patience, criteria.SMALLEST_UNCERTAINTY) == (1, 2, 3.0)
    assert (SETTINGS.effort.beam, SETTINGS.smoothing.patience, criteria.SMALLEST_UNCERTAINTY) == before


def test_a_number_that_is_not_there_is_refused():
    with pytest.raises(UsageError, match="no setting"), changed({"effort.beams": 1}):
        pass


def test_jobs_are_tuning_jobs_and_differ():
    assert len(set(JOBS)) == len(JOBS)
    assert all(key.seed < 1000 for key in JOBS)


def test_right_forms_and_verdicts_that_hold_are_counted():
    one = Replay(0, ("right", "other"), ("exact", "good"), (1.0, 0.5), ("x", "y"), 2.0)
    two = Replay(1, ("other",), ("good",), (0.99,), ("z",), 3.0)
    assert summary("base", [one, two]) == ("base", "1 of 3", "2 of 3", "5")


def test_only_equations_that_came_out_otherwise_are_told():
    old = Replay(0, ("right", "other"), ("good", "good"), (None, None), ("x", "y"), 2.0)
    new = Replay(0, ("right", "right"), ("good", "good"), (None, None), ("x", "z"), 2.0)
    (line,) = differences([old], [new])
    assert line.endswith("other good -> right good: y -> z")
    assert not [*differences([old], [old])]
