"""Many runs over several processes, and their file."""

import math

import pytest

from atoll_core.errors import AtollError
from benchmarks.harness import parallel as runs
from benchmarks.harness.command_line import whole
from benchmarks.harness.parallel import in_parallel


@pytest.fixture(autouse=True)
def _kernels_are_ready(monkeypatch):
    """Let no test here load kernels, which none of them uses."""
    monkeypatch.setattr(runs, "warm_up", lambda report: None)


def test_every_task_is_done_once_whatever_the_order():
    assert sorted(in_parallel(math.factorial, range(6), 2)) == [1, 1, 2, 6, 24, 120]


def test_an_error_in_a_run_reaches_the_caller():
    with pytest.raises(ValueError, match=r"math domain|nonnegative"):
        list(in_parallel(math.sqrt, [-1.0], 1))


def test_runs_that_never_end_are_given_up(monkeypatch):
    import time

    monkeypatch.setattr(runs, "RUN_LIMIT_S", 0.2)
    with pytest.raises(AtollError, match="no run has ended for 0 s"):
        list(in_parallel(time.sleep, [60.0], 1))


@pytest.mark.parametrize("text", ["0", "-1", "x", "1.5", ""])
def test_a_number_of_processes_is_at_least_one(text):
    import argparse

    with pytest.raises(argparse.ArgumentTypeError, match="whole number"):
        whole(text)
