"""Limits as they are written, what is said of files that cannot be, and what a job may take."""

from pathlib import Path

import pytest

from atoll_coordinator.service.scheduling import limits as module
from atoll_coordinator.service.scheduling.limits import NO_LIMITS, Allowance, Limits, Times, read_limits
from atoll_core.config import BudgetConfig, JobConfig
from atoll_core.errors import RefusedError, UsageError


def written(tmp_path: Path, text: str) -> Path:
    file = tmp_path / "limits.toml"
    file.write_text(text)
    return file


def test_the_example_of_the_module_is_read(tmp_path: Path) -> None:
    example = (module.__doc__ or "").split("\n\n", 1)[1]
    limits = read_limits(written(tmp_path, "\n".join(line.strip() for line in example.splitlines())))
    assert (limits.total.running, limits.total.queued, limits.total.stored) == (4, 100_000, 100 * 10**9)
    assert limits.of("bob") == limits.of(None) == Allowance(running=2, queued=1000, stored=2 * 10**9, task_time=86400)
    assert limits.of("ann") == Allowance(running=2, queued=5000, stored=2 * 10**9, task_time=86400)
    assert limits.time == Times(default=3600.0, most=43200.0)


def test_an_empty_file_limits_what_is_limited_anyway(tmp_path: Path) -> None:
    assert read_limits(written(tmp_path, "")) == NO_LIMITS
    assert NO_LIMITS.of("ann") == Allowance()
    assert NO_LIMITS.with_time(JobConfig()) == JobConfig()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[user", "are not valid TOML"),
        ("[users]\nann = 3", "have 3 as users.ann"),
        ("[user]\nrunnign = 1", "have user.runnign, which is unknown; known here: running, queued, stored, task_time"),
        ("[usr]\nrunning = 1", "have usr, which is unknown; known here: total, user, users, time"),
        ("[user]\nrunning = 0", "have 0 as user.running, but greater than or equal to 1 was expected"),
        ("[user]\nrunning = '2'", "have '2' as user.running, but a valid integer was expected"),
        ("[user]\nstored = '2X'", "have '2X' as user.stored, but a number of bytes such as 500000000, 500M or 2G"),
        ("[user]\ntask_time = 'long'", "have 'long' as user.task_time, but a time such as 90s, 30m or 12h was"),
        ("[users]\nann = 5", "have 5 as users.ann, but a table of its own, such as [users.ann], was expected"),
        ("[time]\nmost = 0", "have 0 as time.most, but greater than 0 was expected"),
        ("[time]\nmost = '1h'\ndefault = '2h'", "a default of at most 3600 s (the value of most) instead of 7200 s"),
        ("[time]\nmaximal = '1h'", "have time.maximal, which is unknown; known here: default, most"),
    ],
)
def test_what_is_wrong_is_said_in_one_sentence(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(UsageError) as error:
        read_limits(written(tmp_path, text))
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_a_file_that_is_not_there_is_bad_usage(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"cannot be read \(no such file"):
        read_limits(tmp_path / "none.toml")


def timed(seconds: float | None) -> JobConfig:
    return JobConfig(budget=BudgetConfig(max_time=seconds))


def test_jobs_have_the_time_that_is_given_to_them() -> None:
    limits = Limits(time=Times(default=60.0, most=100.0))
    assert limits.with_time(timed(None)).budget.max_time == 60.0
    assert limits.with_time(timed(100.0)).budget.max_time == 100.0
    assert Limits(time=Times(most=100.0)).with_time(timed(None)).budget.max_time == 100.0
    with pytest.raises(RefusedError, match="asks for 101 s, but this coordinator allows a job at most 100 s"):
        limits.with_time(timed(101.0))
