"""Jobs of benchmarks are timed by state, and end when they take too long."""

import sys

import pytest

from atoll_core.errors import AtollError
from atoll_core.wire.messages.views import JobView
from benchmarks.harness.service import Machines, Searches
from benchmarks.harness.stopwatch import Stopwatch
from benchmarks.noise.data import Key, case
from benchmarks.noise.judging import search

KEY = Key("atoll", "glider", 0.05, 100)


VIEW = {"job": "j", "name": "n", "seed": 0, "preset": "default", "submitted": "", "elapsed": 0.0, "workers": 1}


def view(state):
    return JobView(**VIEW, state=state, point_evaluations=0)


class Client:
    """A coordinator's client whose job stays in one state."""

    def __init__(self, state, reason=None):
        self.view = view(state).model_copy(update={"reason": reason})
        self.cancelled = []

    def upload(self, data):
        return "digest"

    def submit(self, job, name, config, digest):
        self.job = job

    def status(self, job):
        return self.view

    def cancel(self, job):
        self.cancelled.append(job)

    def now(self):
        return 0.0

    def pause(self, seconds):
        return None


def test_a_job_that_takes_too_long_is_cancelled(tmp_path):
    client = Client("refining")
    with pytest.raises(AtollError, match=r"was cancelled: it was still refining after 0 s"):
        Searches(client, Machines(tmp_path, 0)).solve("n", case(KEY).table, None, Stopwatch(limit_s=0.0).watch)
    assert client.cancelled == [client.job]


def test_without_a_coordinator_the_benchmark_ends_instead_of_counting_misses(tmp_path):
    machines = Machines(tmp_path, 0)
    machines.start_program("coordinator", [sys.executable, "-c", "pass"]).wait(20)
    with pytest.raises(AtollError, match="ended with code 0"):
        search(Searches(Client("failed"), machines), KEY, case(KEY), None)
    machines.close()
