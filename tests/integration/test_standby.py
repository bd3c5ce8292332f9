"""Real coordinators over one store: one on standby takes over, and a copy goes on; the answer is that of a calm run."""

import contextlib
import json
import os
import signal
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.programs import LIMIT_S, ROOT, done, started, until

JOB = (str(ROOT / "examples" / "lynx_hare.csv"), "--time", "year", "--preset", "paper", "--seed", "3")
EPOCHS = ("--max-epochs", "20")
EARLY = 2
"""Epochs after which a coordinator dies, with most still to come."""


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the digest of the job where nothing happens."""
    place = tmp_path_factory.mktemp("calm")
    ended = done(place, "coordinator", "run", *JOB, *EPOCHS, "--workers", "1", "--out", "out")
    assert ended.returncode == 0, ended.stderr
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


def jobs_at(place: Path, address: str) -> list[dict[str, Any]]:
    ended = done(place, "coordinator", "jobs", "--json", "--connect", address)
    return list(json.loads(ended.stdout)) if ended.returncode == 0 else []


def is_under_way(place: Path, address: str) -> bool:
    return any(
        job["variables"] and min(variable["epoch"] for variable in job["variables"]) >= EARLY
        for job in jobs_at(place, address)
    )


@contextlib.contextmanager
def searched(place: Path, addresses: str) -> Iterator[subprocess.Popen[str]]:
    """Submit the job and follow it, with one worker, both at several addresses."""
    with (
        started(place, "island_worker", "--connect", addresses, "--processes", "1", "--wait", "120"),
        started(place, "coordinator", "submit", *JOB, *EPOCHS, "--out", "out", "--connect", addresses) as following,
    ):
        yield following


def test_a_coordinator_on_standby_takes_over_when_the_other_is_killed(tmp_path: Path, calm: str) -> None:
    first_at, second_at = free_address(), free_address()
    with first_and_standby(tmp_path, first_at, second_at) as (first, second):
        with searched(tmp_path, f"{first_at},{second_at}") as following:
            until(lambda: is_under_way(tmp_path, first_at))
            first.kill()
            serves(second)
            assert following.wait(LIMIT_S) == 0
        assert digest_in(tmp_path / "out") == calm
        (job,) = jobs_at(tmp_path, second_at)
        assert job["state"] == "done"
        second.send_signal(signal.SIGTERM)
        assert second.wait(LIMIT_S) == 0


@pytest.mark.slow
def test_a_coordinator_that_hangs_is_replaced_and_ends_when_it_goes_on(tmp_path: Path, calm: str) -> None:
    first_at, second_at = free_address(), free_address()
    with first_and_standby(tmp_path, first_at, second_at) as (first, second):
        with searched(tmp_path, f"{first_at},{second_at}") as following:
            until(lambda: is_under_way(tmp_path, first_at))
            os.kill(first.pid, signal.SIGSTOP)
            serves(second)
            os.kill(first.pid, signal.SIGCONT)
            assert first.wait(LIMIT_S) == 1
            assert "another coordinator (incarnation 2) has taken over the store" in log_of(tmp_path, "first")
            assert following.wait(LIMIT_S) == 0
        assert digest_in(tmp_path / "out") == calm


@pytest.mark.slow
def test_a_copy_taken_while_jobs_run_goes_on_to_the_same_answer(tmp_path: Path, calm: str) -> None:
    address = free_address()
    with coordinator(tmp_path, "first", address) as first:
        serves(first)
        with searched(tmp_path, address):
            until(lambda: is_under_way(tmp_path, address))
            copied = done(tmp_path, "coordinator", "backup", "copy", "--state", "state")
            assert copied.returncode == 0, copied.stderr
            assert "jobs 1" in copied.stdout
        refused = done(tmp_path, "coordinator", "restore", "copy", "--state", "state")
        assert (refused.returncode, len(refused.stderr.splitlines())) == (2, 1)
        assert "in use by another coordinator" in refused.stderr
        first.kill()
        first.wait(LIMIT_S)
    restored = done(tmp_path, "coordinator", "restore", "copy", "--state", "state", "--replace")
    assert restored.returncode == 0, restored.stderr
    with (
        coordinator(tmp_path, "second", address) as second,
        started(tmp_path, "island_worker", "--connect", address, "--processes", "1", "--wait", "60"),
    ):
        serves(second)
        (job,) = jobs_at(tmp_path, address)
        ended = done(tmp_path, "coordinator", "status", job["job"], "--follow", "--connect", address)
        assert ended.returncode == 0, ended.stderr
        result = done(tmp_path, "coordinator", "result", job["job"], "--format", "json", "--connect", address)
        assert json.loads(result.stdout)["digest"] == calm


def test_a_coordinator_on_standby_can_be_told_to_end(tmp_path: Path) -> None:
    with first_and_standby(tmp_path, free_address(), free_address()) as (_, second):
        second.send_signal(signal.SIGTERM)
        assert second.wait(LIMIT_S) == 0
        assert "stopped on standby" in log_of(tmp_path, "second")
