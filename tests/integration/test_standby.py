"""Real coordinators over one store: one on standby takes over, and a copy goes on; the answer is that of a calm run."""

import contextlib
import json
import math
import os
import signal
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from atoll.client.client import connected
from atoll_core.wire.messages.views import JobView
from tests.programs import LIMIT_S, done, started, until

JOB = ("data.csv", "--derivatives", "dx,dy", "--seed", "3", "--islands", "3", "--target-error", "1e-300")
EPOCHS = ("--preset", "paper", "--max-epochs", "40")
EARLY = 4
"""Epochs after which a coordinator dies, with most still to come."""
MISSED = 4
"""Exit code of this job, whose target nothing meets, so that it ends after all of its epochs."""
"""A job of which refining takes longer than all else."""


def write_data(place: Path) -> None:
    """Write a table of an oscillator with its derivatives, of which refining takes least."""
    rows = [(0.1 * step, math.cos(0.1 * step), math.sin(0.1 * step)) for step in range(80)]
    lines = [f"{t:.1f},{x!r},{y!r},{-y - 0.1 * x * y:.6f},{x + 0.2 * y * y:.6f}" for t, x, y in rows]
    (place / "data.csv").write_text("\n".join(["t,x,y,dx,dy", *lines]) + "\n")


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """Return a folder with the table."""
    write_data(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the digest of the job where nothing happens."""
    place = tmp_path_factory.mktemp("calm")
    write_data(place)
    ended = done(place, "coordinator", "run", *JOB, *EPOCHS, "--workers", "1", "--out", "out")
    assert ended.returncode == MISSED, ended.stderr
    return digest_in(place / "out")


def digest_in(folder: Path) -> str:
    return str(json.loads((folder / "result.json").read_text())["digest"])


def free_address() -> str:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@contextlib.contextmanager
def coordinator(place: Path, name: str, address: str, *options: str) -> Iterator[subprocess.Popen[str]]:
    """Start a coordinator whose log is ``name/coordinator.log`` on the store that all of them share."""
    (place / name).mkdir(exist_ok=True)
    words = ("serve", "--listen", address, "--state", str(place / "state"), *options)
    with started(place / name, "coordinator", *words) as process:
        yield process


def log_of(place: Path, name: str) -> str:
    return (place / name / "coordinator.log").read_text()


def serves(process: subprocess.Popen[str]) -> None:
    """Wait until a coordinator says that it listens."""
    assert process.stdout is not None
    assert any("start a worker with" in line for line in process.stdout), "it ended without serving"


@contextlib.contextmanager
def first_and_standby(
    place: Path, first_at: str, second_at: str
) -> Iterator[tuple[subprocess.Popen[str], subprocess.Popen[str]]]:
    """Start a coordinator, and another one that says that it is on standby."""
    with coordinator(place, "first", first_at) as first:
        serves(first)
        with coordinator(place, "second", second_at, "--standby") as second:
            until(lambda: "this one is on standby" in log_of(place, "second"))
            yield first, second


def wait_until_under_way(address: str) -> None:
    """Wait until the only job has come to epoch `EARLY`, with many still to come."""
    with connected(address, LIMIT_S) as client:

        def is_under_way() -> bool:
            variables = [variable for job in client.jobs() for variable in job.variables]
            return bool(variables) and min(variable.epoch for variable in variables) >= EARLY

        until(is_under_way)


def only_job(address: str) -> JobView:
    with connected(address, LIMIT_S) as client:
        (job,) = client.jobs()
        return job


@contextlib.contextmanager
def searched(place: Path, addresses: str, *job: str) -> Iterator[subprocess.Popen[str]]:
    """Submit a job, the usual one by default, and follow it, with one worker, both at several addresses."""
    with (
        started(place, "island_worker", "--connect", addresses, "--processes", "1", "--wait", "120"),
        started(
            place, "coordinator", "submit", *(job or (*JOB, *EPOCHS)), "--out", "out", "--connect", addresses
        ) as following,
    ):
        yield following


@pytest.mark.slow
def test_a_coordinator_on_standby_takes_over_when_the_other_is_killed(place: Path, calm: str) -> None:
    first_at, second_at = free_address(), free_address()
    with first_and_standby(place, first_at, second_at) as (first, second):
        with searched(place, f"{first_at},{second_at}") as following:
            wait_until_under_way(first_at)
            first.kill()
            serves(second)
            assert following.wait(LIMIT_S) == MISSED
        assert digest_in(place / "out") == calm
        assert only_job(second_at).state == "done"
        second.send_signal(signal.SIGTERM)
        assert second.wait(LIMIT_S) == 0


@pytest.mark.slow
def test_a_coordinator_that_hangs_is_replaced_and_ends_when_it_goes_on(place: Path, calm: str) -> None:
    first_at, second_at = free_address(), free_address()
    with first_and_standby(place, first_at, second_at) as (first, second):
        with searched(place, f"{first_at},{second_at}") as following:
            wait_until_under_way(first_at)
            os.kill(first.pid, signal.SIGSTOP)
            serves(second)
            os.kill(first.pid, signal.SIGCONT)
            assert first.wait(LIMIT_S) == 1
            assert "another coordinator (incarnation 2) has taken over the store" in log_of(place, "first")
            assert following.wait(LIMIT_S) == MISSED
        assert digest_in(place / "out") == calm


@pytest.mark.slow
def test_a_copy_taken_while_jobs_run_goes_on_to_the_same_answer(place: Path, calm: str) -> None:
    address = free_address()
    with coordinator(place, "first", address) as first:
        serves(first)
        with searched(place, address):
            wait_until_under_way(address)
            copied = done(place, "coordinator", "backup", "copy", "--state", "state")
            assert copied.returncode == 0, copied.stderr
            assert "jobs 1" in copied.stdout
        refused = done(place, "coordinator", "restore", "copy", "--state", "state")
        assert (refused.returncode, len(refused.stderr.splitlines())) == (1, 1)
        assert "in use by another coordinator" in refused.stderr
        first.kill()
        first.wait(LIMIT_S)
    restored = done(place, "coordinator", "restore", "copy", "--state", "state", "--replace")
    assert restored.returncode == 0, restored.stderr
    with (
        coordinator(place, "second", address) as second,
        started(place, "island_worker", "--connect", address, "--processes", "1", "--wait", "60"),
    ):
        serves(second)
        job = only_job(address).job
        ended = done(place, "coordinator", "status", job, "--follow", "--connect", address)
        assert ended.returncode == MISSED, ended.stderr
        result = done(place, "coordinator", "result", job, "--format", "json", "--connect", address)
        assert json.loads(result.stdout)["digest"] == calm


def test_a_coordinator_on_standby_can_be_told_to_end(place: Path) -> None:
    with first_and_standby(place, free_address(), free_address()) as (_, second):
        second.send_signal(signal.SIGTERM)
        assert second.wait(LIMIT_S) == 0
        assert "stopped on standby" in log_of(place, "second")
