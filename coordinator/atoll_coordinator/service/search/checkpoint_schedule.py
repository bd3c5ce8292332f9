"""At which epochs checkpoints are taken. Pure."""

from collections.abc import Iterable
from typing import Final

from atoll_core.wire.messages.workers import Schedule

FIRST_INTERVAL: Final = 8
"""Epochs before the first checkpoint, when nothing has been measured; a short search ends before."""

LEAST_INTERVAL: Final = 4
MOST_INTERVAL: Final = 1 << 16
MOST_GROWTH: Final = 8
"""An interval is at most so many times the one before: a few epochs say little about many."""

PAUSE_S: Final = 1.0
"""What is aimed at between two checkpoints, in seconds; about as much is computed again when a worker is lost."""

SHARE: Final = 0.03
"""What checkpoints may cost of all work."""

COST_S: Final = 0.01
COST_S_PER_BYTE: Final = 5e-8
"""Work of one checkpoint, all processes taken together: taken, copied, hashed twice, carried and written."""


def interval_of(epoch_s: float, size: int, former: int) -> int:
    """Return after how many epochs the next checkpoint pays.

    Args:
        epoch_s: seconds that an epoch of the archipelago takes.
        size: bytes of all its states.
        former: the interval before.
    """
    pause_s = max(PAUSE_S, (COST_S + COST_S_PER_BYTE * size) / SHARE)
    most = min(MOST_INTERVAL, MOST_GROWTH * former)
    return max(LEAST_INTERVAL, min(most, round(pause_s / epoch_s) if epoch_s > 0.0 else most))


def schedule_after(schedule: Schedule, epoch: int, interval: int, wants_barrier: bool) -> Schedule:
    """Return the checkpoints that follow when the one for `epoch` is durable.

    The one that workers know already stays; the new one lies `interval` epochs behind it or, when it is to be a
    barrier, one epoch: no island can have passed an epoch that no worker knows of.
    """
    if schedule.holds:
        return Schedule(next=schedule.last, last=schedule.last, holds=True)
    is_known = epoch < schedule.last
    if wants_barrier:
        return Schedule(next=schedule.last if is_known else schedule.last + 1, last=schedule.last + 1, holds=True)
    following = schedule.last if is_known else schedule.last + interval
    return Schedule(next=following, last=following + interval)


def common_epoch(snapshots: Iterable[Iterable[int]], beyond: int) -> int | None:
    """Return the latest epoch beyond a commit of which every worker has snapshots; None: there is none."""
    sets = [set(epochs) for epochs in snapshots]
    shared = set.intersection(*sets) if sets else set()
    return max((epoch for epoch in shared if epoch > beyond), default=None)
