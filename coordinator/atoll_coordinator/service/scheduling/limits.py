"""Limits of each user and of all users together, read from a TOML file, and the task time that users have used.

[total]
running = 4                  # jobs that are prepared or searched at a time; further jobs wait
queued = 100000              # jobs that wait; further jobs are refused
stored = "100G"              # bytes of tables and results; further tables and jobs are refused

[user]                       # every single user
running = 2
queued = 1000
stored = "2G"
task_time = "24h"            # processor time of workers per day; when it is used up, jobs wait

[users.ann]                  # one user: these values override [user]
queued = 5000

[time]
default = "1h"               # --max-time of jobs without it
most = "12h"                 # the longest --max-time; a job that asks for more is refused
"""

import argparse
import re
import tomllib
from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Final

from pydantic import BeforeValidator, Field, ValidationError, model_validator

from atoll_core.command_line import duration
from atoll_core.config import Frozen, JobConfig
from atoll_core.errors import RefusedError, UsageError
from atoll_core.quoting import did_you_mean

MAX_RUNNING: Final = 4
"""Default number of jobs that are prepared or searched: each has its table and fronts in memory."""

MAX_QUEUED: Final = 100_000
"""Default number of waiting jobs: each takes 11 kB of memory; waiting jobs do not slow down the loop."""

DAY_S: Final = 86_400.0
"""A day of service: the task time is reset whenever the store has been served for this number of seconds."""

_SIZES: Final = {"k": 10**3, "M": 10**6, "G": 10**9, "T": 10**12}


def _size(value: object) -> object:
    """Return the bytes of ``500M`` or ``2G``; numbers are bytes."""
    match = re.fullmatch("([0-9]{1,12})([kMGT]?)", value) if isinstance(value, str) else None
    if match is not None:
        return int(match[1]) * _SIZES.get(match[2], 1)
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError("a number of bytes such as 500000000, 500M or 2G")
    return value


def _seconds(value: object) -> object:
    """Return the seconds of ``90s``, ``30m``, ``12h`` or ``2d``; numbers are seconds."""
    if isinstance(value, str):
        try:
            return duration(value)
        except argparse.ArgumentTypeError:
            value = None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError("a time such as 90s, 30m or 12h")
    return float(value)


_Jobs = Annotated[int, Field(ge=1, le=10_000_000, strict=True)]
_Places = Annotated[int, Field(ge=1, le=10_000, strict=True)]
_Bytes = Annotated[int, BeforeValidator(_size), Field(ge=0, lt=2**60)]
_Seconds = Annotated[float, BeforeValidator(_seconds), Field(ge=0.0, lt=1e9)]
_Time = Annotated[float, BeforeValidator(_seconds), Field(gt=0.0, lt=1e9)]


class Allowance(Frozen):
    """Limits of one user, or of all users together; None: no limit.

    `running` limits jobs that are prepared or searched, `queued` waiting jobs, `stored` the bytes of tables and
    results, `task_time` the seconds of processors in a day (`DAY_S`).
    """

    running: _Places | None = None
    queued: _Jobs | None = None
    stored: _Bytes | None = None
    task_time: _Seconds | None = None


class Total(Allowance):
    """Limits of all users together."""

    running: _Places = MAX_RUNNING
    queued: _Jobs = MAX_QUEUED


class Times(Frozen):
    """The `--max-time` of jobs, in seconds: its default and its largest value."""

    default: _Time | None = None
    most: _Time | None = None

    @model_validator(mode="after")
    def _check(self) -> "Times":
        if self.default is not None and self.most is not None and self.default > self.most:
            raise ValueError(f"a default of at most {self.most:g} s (the value of most) instead of {self.default:g} s")
        return self


class Limits(Frozen):
    """All limits."""

    total: Total = Total()
    user: Allowance = Allowance()
    users: dict[str, Allowance] = Field(default_factory=dict)
    time: Times = Times()

    def of(self, user: str | None) -> Allowance:
        """Return the limits of a user: the user's own limits, and the general limits of users where the user has
        none."""
        own = self.users.get(user) if user is not None else None
        if own is None:
            return self.user
        return self.user.model_copy(update=own.model_dump(exclude_unset=True))

    def with_time(self, config: JobConfig) -> JobConfig:
        """Return a job's configuration with its time limit; raises RefusedError if the job asks for more time than
        allowed."""
        asked, most = config.budget.max_time, self.time.most
        if asked is not None and most is not None and asked > most:
            raise RefusedError(
                f"--max-time asks for {asked:g} s, but this coordinator allows a job at most {most:g} s; ask for less"
            )
        limit = asked if asked is not None else self.time.default if self.time.default is not None else most
        if limit == asked:
            return config
        return config.model_copy(update={"budget": config.budget.model_copy(update={"max_time": limit})})


NO_LIMITS: Final = Limits()


def read_limits(path: Path) -> Limits:
    """Return the limits in the TOML file `path`; raises UsageError."""
    try:
        entries = tomllib.loads(path.read_text("utf-8"))
    except OSError as error:
        reason = (error.strerror or "unknown").lower()
        raise UsageError(f"the limits {path} cannot be read ({reason}); docs/service.md shows such a file") from error
    except ValueError as error:
        raise UsageError(f"the limits {path} are not valid TOML: {error}") from error
    try:
        return Limits.model_validate(entries)
    except ValidationError as error:
        raise UsageError(f"the limits {path} {_complaint(error)}") from error


def _complaint(error: ValidationError) -> str:
    """Return the end of a sentence about the first error: what was found, what was expected."""
    first = error.errors()[0]
    path = [str(part) for part in first["loc"]]
    place = ".".join(path) or "as a whole"
    if first["type"] == "extra_forbidden":
        model: type[Frozen] = Limits if len(path) == 1 else Times if path[0] == "time" else Allowance
        known = tuple(model.model_fields)
        return f"have {place}, which is unknown; known here: {', '.join(known)}{did_you_mean(path[-1], known)}"
    what = first["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    if first["type"] == "model_type":
        what = f"a table of its own, such as [{place}],"
    return f"have {first.get('input')!r} as {place}, but {what} was expected"


Amounts = Mapping[str | None, float]
"""Seconds by user."""


class TaskTime:
    """The task time of users today, in seconds of workers' processors, and the part of it that is not stored yet.

    A day is a day of service (`DAY_S`), not of the calendar, so a wrong clock changes nothing.
    """

    def __init__(self, day: int = 0, used: Amounts | None = None) -> None:
        """`used` is the stored task time of the day with number `day`."""
        self._day = day
        self._used: dict[str | None, float] = defaultdict(float, used or {})
        self._unsaved: dict[str | None, float] = defaultdict(float)
        self._totals: dict[tuple[str, str], dict[str | None, float]] = {}

    def charge(self, user: str | None, seconds: float) -> None:
        """Add to the task time of a user."""
        self._used[user] += seconds
        self._unsaved[user] += seconds

    def add_heartbeat(self, worker: str, instance: str, computed: Iterable[tuple[str | None, float]]) -> None:
        """Charge users for the computing time of a worker process since its last heartbeat.

        The first heartbeat charges nothing: an earlier coordinator has counted the time before it.
        """
        totals = dict(computed)
        before = self._totals.get((worker, instance))
        if before is None:
            self._totals = {key: known for key, known in self._totals.items() if key[0] != worker}
            before = totals
        for user, seconds in totals.items():
            if seconds > before.get(user, 0.0):
                self.charge(user, seconds - before.get(user, 0.0))
        self._totals[worker, instance] = totals

    def begin_day(self, day: int) -> None:
        """Reset the task time if the day has changed."""
        if day != self._day:
            self._day, self._used = day, defaultdict(float)

    def take_unsaved(self) -> dict[str | None, float]:
        """Return the task time that has been added since the last call."""
        unsaved, self._unsaved = self._unsaved, defaultdict(float)
        return dict(unsaved)

    def is_used_up(self, user: str | None, limits: Limits) -> bool:
        """Return whether a user, or all users together, have used up the task time of today."""
        own, total = limits.of(user).task_time, limits.total.task_time
        is_own_used_up = own is not None and self._used.get(user, 0.0) >= own
        return is_own_used_up or (total is not None and sum(self._used.values()) >= total)
