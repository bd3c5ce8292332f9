"""From a schedule that fails to a short one that fails alike: what is not needed for it is left out."""

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Final

from tests.simulation.harness.fault_schedule import Schedule
from tests.simulation.harness.schedule_run import Outcome

Play = Callable[[Schedule], Outcome]

_NAMES: Final = re.compile(r"[0-9]+|'[^']*'")


def shrunk(schedule: Schedule, play: Play) -> Schedule:
    """Return a schedule of no more faults that fails as this one does; itself when it does not fail."""
    wanted = failure_of(play(schedule))
    if wanted is None:
        return schedule
    while (shorter := _shorter(schedule, play, wanted)) is not None:
        schedule = shorter
    return schedule


def failure_of(outcome: Outcome) -> str | None:
    """Return what went wrong first, without names and numbers; None when nothing did."""
    return _NAMES.sub("", outcome.wrong[0])[:60] if outcome.wrong else None


def _shorter(schedule: Schedule, play: Play, wanted: str) -> Schedule | None:
    return next((candidate for candidate in _candidates(schedule) if failure_of(play(candidate)) == wanted), None)


def _candidates(schedule: Schedule) -> Iterator[Schedule]:
    """Yield schedules with less in them, those with much less first."""
    faults = schedule.faults
    if len(faults) > 3:
        half = len(faults) // 2
        yield replace(schedule, faults=faults[half:])
        yield replace(schedule, faults=faults[:half])
    for place in range(len(faults)):
        yield replace(schedule, faults=(*faults[:place], *faults[place + 1 :]))
    for place in range(len(schedule.guests)):
        yield replace(schedule, guests=(*schedule.guests[:place], *schedule.guests[place + 1 :]))
    if len(schedule.jobs) > 1:
        for place in range(len(schedule.jobs)):
            yield replace(schedule, jobs=(*schedule.jobs[:place], *schedule.jobs[place + 1 :]))
    for name in ("drop", "duplicate", "late", "unsent_s"):
        if getattr(schedule.plan, name):
            yield replace(schedule, plan=replace(schedule.plan, **{name: 0.0}))
    for place, job in enumerate(schedule.jobs):
        if job.cancel_s is not None:
            jobs = (*schedule.jobs[:place], replace(job, cancel_s=None), *schedule.jobs[place + 1 :])
            yield replace(schedule, jobs=jobs)
    if schedule.workers > 1:
        yield replace(schedule, workers=schedule.workers - 1)
