"""What a worker tells the coordinator of its log: lines of jobs and warnings, bounded."""

import logging

import pytest

from atoll_core.logs import about, fields
from atoll_core.wire.codec import decode, encode
from atoll_core.wire.messages.workers import MAX_LINES, WorkerLog
from atoll_island_worker.job_logs import BURST, RATE, JobLogs


class Clock:
    def __init__(self) -> None:
        self.s = 100.0

    def __call__(self) -> float:
        return self.s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def logs(clock: Clock) -> JobLogs:
    return JobLogs(clock)


def log(logs: JobLogs, level: int, words: str, **values: object) -> None:
    made = logging.LogRecord("worker", level, "file", 1, words, None, None)
    made.__dict__.update(fields(**values))
    logs.handle(made)


def test_lines_of_jobs_and_warnings_are_told_and_nothing_else(logs: JobLogs) -> None:
    log(logs, logging.INFO, "joined")
    log(logs, logging.INFO, "placed", job="a", variable="x", term=3, islands=4)
    log(logs, logging.WARNING, "connection lost")
    with about(job="b"):
        log(logs, logging.INFO, "said within")
    told = logs.take()
    assert told is not None
    assert decode(encode(told), WorkerLog) == told
    assert [(line.job, line.level, line.text) for line in told.lines] == [
        ("a", "info", "placed islands=4"), (None, "warning", "connection lost"), ("b", "info", "said within")
    ]  # fmt: skip
    assert (told.lines[0].variable, told.lines[0].term, told.dropped) == ("x", 3, 0)
    assert logs.take() is None


def test_what_comes_too_fast_is_counted_and_comes_again_later(logs: JobLogs, clock: Clock) -> None:
    for number in range(BURST + 30):
        log(logs, logging.INFO, str(number), job="a")
    first = logs.take()
    assert first is not None
    assert (len(first.lines), first.dropped) == (min(BURST, MAX_LINES), 30)
    while logs.take() is not None:
        pass
    log(logs, logging.INFO, "too early", job="a")
    clock.s += 1.0
    for number in range(round(RATE) + 5):
        log(logs, logging.INFO, str(number), job="a")
    later = logs.take()
    assert later is not None
    assert (len(later.lines), later.dropped) == (round(RATE), 6)


def test_a_line_of_any_length_and_with_any_field_can_be_told(logs: JobLogs) -> None:
    log(logs, logging.CRITICAL, "x" * 5000, job="a", island=-1, epoch="seven", variable="v" * 400)
    told = logs.take()
    assert told is not None
    (line,) = decode(encode(told), WorkerLog).lines
    assert (line.level, len(line.text), line.island, line.epoch) == ("error", 1000, None, None)


def test_a_line_that_cannot_be_told_is_counted(logs: JobLogs) -> None:
    log(logs, logging.INFO, "of no job that there can be", job="no id!")
    told = logs.take()
    assert told is not None
    assert (told.lines, told.dropped) == ((), 1)
