"""The end that ``--max-time`` sets: choosing equations ends first, and what is left out is remembered."""

from atoll_coordinator.model.deadline import CHOICE_SHARE, Deadline


class Clock:
    def __init__(self) -> None:
        self.now = 50.0

    def __call__(self) -> float:
        return self.now


def test_without_seconds_time_is_never_over() -> None:
    clock = Clock()
    deadline = Deadline(None, clock)
    clock.now = 1e9
    assert not deadline.is_over
    assert not deadline.has_cut_short


def test_choosing_ends_before_the_last_stage() -> None:
    clock = Clock()
    deadline = Deadline(10.0, clock)
    clock.now += 10.0 * CHOICE_SHARE - 0.01
    assert not deadline.is_over
    assert not deadline.has_cut_short
    clock.now += 0.02
    assert deadline.is_over
    deadline.begin_last_stage()
    assert not deadline.is_over
    assert deadline.has_cut_short
    clock.now = 60.0
    assert deadline.is_over
