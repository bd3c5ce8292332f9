"""The programs as people use them: real processes, a real router, real kernels."""

import contextlib
import json
import os
import signal
import subprocess
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest

from tests.programs import LIMIT_S, ROOT, done, started, until

DATA = str(ROOT / "examples" / "lotka_volterra.csv")


def coordinator(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return done(cwd, "coordinator", *words)


def begun(*words: str, cwd: Path, program: str = "coordinator") -> AbstractContextManager[subprocess.Popen[str]]:
    """Start a program whose stderr is read; its end is the test's business, but not beyond the test."""
    return started(cwd, program, *words, keeps_log=False)


def read_until(stream: Any, words: str) -> str:
    """Return the lines up to the first that contains `words`."""
    lines = []
    for line in stream:
        lines.append(line)
        if words in line:
            return "".join(lines)
    raise AssertionError(f"{words!r} never came; what came was: {''.join(lines)}")


def finish(process: subprocess.Popen[str]) -> tuple[str, str]:
    """Return what is still to be read of stdout and stderr of a process that ends by itself."""
    assert process.stdout is not None
    assert process.stderr is not None
    err, out = process.stderr.read(), process.stdout.read()
    process.wait(LIMIT_S)
    return out, err


def workers_of(run: Path) -> list[int]:
    """Return the process ids of the workers of the run in that folder."""
    lines = []
    for entry in Path("/proc").iterdir():
        with contextlib.suppress(OSError):
            words = (entry / "cmdline").read_bytes().decode().split("\0")
            if "atoll_island_worker" in words and str(run) == str((entry / "cwd").readlink()):
                lines.append(int(entry.name))
    return lines


def parent_of(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


def watcher_of(run: Path, process: subprocess.Popen[str]) -> tuple[int, list[int]]:
    """Return who watches over the workers of a run, and its children: the server of tasks, then the workers."""
    parents = {pid: parent_of(pid) for pid in workers_of(run)}
    (watcher,) = (pid for pid, parent in parents.items() if parent == process.pid)
    return watcher, sorted(pid for pid, parent in parents.items() if parent == watcher)


def test_run_finds_the_equations_writes_the_result_and_leaves_no_process(tmp_path: Path) -> None:
    ended = coordinator("run", DATA, "--workers", "2", "--out", "out", "--json", cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    printed = json.loads(ended.stdout)
    assert printed == json.loads((tmp_path / "out" / "result.json").read_text())
    assert (printed["schema"], printed["state"]) == (1, "done")
    assert [equation["converged"] for equation in printed["equations"]] == [True, True]
    assert [equation["verdict"] for equation in printed["equations"]] == ["exact", "exact"]
    for words in ("4 trajectories", "states: x, y", "(exact)", "total", "result in out/result.json"):
        assert words in ended.stderr
    assert workers_of(tmp_path) == []
    again = coordinator("run", DATA, "--out", "out", cwd=tmp_path)
    assert again.returncode == 2
    assert again.stderr == (
        "coordinator: out/result.json exists already; name another folder with --out, or remove it\n"
    )


ENDLESS = ["--target-error", "1e-300", "--max-epochs", "1000000", "--workers", "2", "--out", "out"]


@pytest.mark.slow
def test_an_interrupt_keeps_the_best_so_far_and_leaves_no_process(tmp_path: Path) -> None:
    with begun("run", DATA, *ENDLESS, cwd=tmp_path) as process:
        read_until(process.stderr, "(searching)")
        _, children = watcher_of(tmp_path, process)
        assert len(children) == 3, "two, and the server of tasks"
        process.send_signal(signal.SIGTERM)
        out, err = finish(process)
    assert process.returncode == 130, err
    assert "dx/dt = " in out
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["state"] == "cancelled"
    assert workers_of(tmp_path) == []


def test_no_worker_survives_a_run_that_is_killed(tmp_path: Path) -> None:
    with begun("run", DATA, *ENDLESS, cwd=tmp_path) as process:
        read_until(process.stderr, "(searching)")
        process.kill()
        process.wait()
        assert until(lambda: not workers_of(tmp_path))


@pytest.mark.slow
def test_a_worker_that_dies_is_said_and_started_again_as_long_as_somebody_watches(tmp_path: Path) -> None:
    with begun("run", DATA, *ENDLESS, cwd=tmp_path) as process:
        read_until(process.stderr, "(searching)")
        watcher, (_, dead, _) = watcher_of(tmp_path, process)
        os.kill(dead, signal.SIGKILL)
        read_until(process.stderr, f"process {dead} (w-")
        os.kill(watcher, signal.SIGKILL)
        _, err = finish(process)
        assert until(lambda: not workers_of(tmp_path))
    assert process.returncode == 1
    assert "the supervisor process of the workers has ended" in err


def test_nobody_at_the_address_is_exit_code_3_within_seconds(tmp_path: Path) -> None:
    ended = coordinator("jobs", "--connect", "tcp/127.0.0.1:9", cwd=tmp_path)
    assert ended.returncode == 3
    assert ended.stderr.startswith("coordinator: ")
    assert ended.stderr.count("\n") == 1
    assert "tcp/127.0.0.1:9" in ended.stderr


def test_no_address_is_a_usage_error(tmp_path: Path) -> None:
    ended = coordinator("jobs", cwd=tmp_path)
    assert (ended.returncode, "--connect" in ended.stderr, "ATOLL_CONNECT" in ended.stderr) == (2, True, True)


def test_serve_submit_status_result_and_cancel_by_hand(tmp_path: Path) -> None:
    """The story of several machines, on one."""
    with contextlib.ExitStack() as stack:
        serve = stack.enter_context(begun("serve", "--listen", "tcp/127.0.0.1:0", "--state", "s", cwd=tmp_path))
        line = read_until(serve.stdout, "island-worker --connect").splitlines()[-1]
        address = line.split()[-1]
        stack.enter_context(
            begun("--connect", address, "--processes", "1", "--name", "lab", cwd=tmp_path, program="island_worker")
        )
        there = ["--connect", address]

        followed = coordinator("submit", DATA, *there, "--id", "first", cwd=tmp_path)
        assert followed.returncode == 0, followed.stderr
        assert "dx/dt = " in followed.stdout

        endless = ["--target-error", "1e-300", "--max-epochs", "1000000", "--id", "second"]
        assert coordinator("submit", DATA, *there, "--no-wait", *endless, cwd=tmp_path).stdout == "second\n"
        status = json.loads(coordinator("status", "sec", "--json", *there, cwd=tmp_path).stdout)
        assert status["state"] in ("queued", "preparing", "running")
        assert coordinator("cancel", "second", *there, cwd=tmp_path).returncode == 0
        jobs = json.loads(coordinator("jobs", "--json", *there, cwd=tmp_path).stdout)
        assert [job["job"] for job in jobs] == ["first", "second"]
        names = [
            worker["worker"] for worker in json.loads(coordinator("workers", "--json", *there, cwd=tmp_path).stdout)
        ]
        assert names == ["lab"]
        assert "cancelled" in coordinator("status", "second", *there, cwd=tmp_path).stdout
        assert coordinator("delete", "second", *there, cwd=tmp_path).stdout == "job second is deleted\n"
        assert coordinator("status", "second", *there, cwd=tmp_path).returncode == 2

        picked = json.loads(coordinator("result", "first", "--pick", "x=0", "--json", *there, cwd=tmp_path).stdout)
        assert picked["job"] == "first"
        assert picked["equations"][0]["front"][0]["selected"]
        assert coordinator("result", "nothing", *there, cwd=tmp_path).returncode == 2

        saved = tmp_path / "saved.json"
        saved.write_text(coordinator("result", "first", "--json", *there, cwd=tmp_path).stdout, "utf-8")
        by_a_worker = coordinator("suggest", "first", *there, cwd=tmp_path)
        assert by_a_worker.returncode == 0, by_a_worker.stderr
        assert by_a_worker.stdout == coordinator("suggest", str(saved), cwd=tmp_path).stdout
        refused = coordinator("analyse", "first", "--box", "nothing=0:1", *there, cwd=tmp_path)
        assert (refused.returncode, refused.stdout) == (2, "")
        assert refused.stderr == "coordinator: the box has 'nothing', but the states are x, y\n"

        serve.send_signal(signal.SIGTERM)
        finish(serve)
        assert serve.returncode == 0


@pytest.mark.slow
def test_ctrl_c_on_submit_detaches_and_the_job_goes_on(tmp_path: Path) -> None:
    with begun("serve", "--listen", "tcp/127.0.0.1:0", "--state", "s", cwd=tmp_path) as serve:
        address = read_until(serve.stdout, "island-worker --connect").splitlines()[-1].split()[-1]
        with begun("submit", DATA, "--connect", address, "--id", "mine", cwd=tmp_path) as process:
            read_until(process.stderr, "no worker has joined; start one with: island-worker --connect")
            process.send_signal(signal.SIGINT)
            out, err = finish(process)
        assert (process.returncode, out) == (130, "")
        assert "coordinator status mine" in err
        jobs = json.loads(coordinator("jobs", "--json", "--connect", address, cwd=tmp_path).stdout)
        assert [(job["job"], job["state"] in ("done", "failed", "cancelled")) for job in jobs] == [("mine", False)]


@pytest.mark.slow
def test_a_service_says_what_it_waits_for_and_what_happened(tmp_path: Path) -> None:
    words = ["serve", "--listen", "tcp/127.0.0.1:0", "--state", "s", "--log-format", "json"]
    with contextlib.ExitStack() as stack:
        serve = stack.enter_context(begun(*words, cwd=tmp_path))
        address = read_until(serve.stdout, "island-worker --connect").splitlines()[-1].split()[-1]
        connect = ["--connect", address]
        job = ["submit", DATA, *connect, "--no-wait", "--id", "one", "--max-epochs", "3", "--priority", "2"]
        for _ in range(2):
            submitted = coordinator(*job, cwd=tmp_path)
            assert (submitted.returncode, submitted.stdout) == (0, "one\n")
            assert f"no worker has joined; start one with: island-worker {' '.join(connect)}" in submitted.stderr
        other = coordinator(*job[:-2], cwd=tmp_path)
        assert (other.returncode, other.stdout) == (2, "")
        assert "exists already with other contents" in other.stderr
        (listed,) = json.loads(coordinator("jobs", *connect, "--json", cwd=tmp_path).stdout)
        assert (listed["job"], listed["priority"], listed["workers"]) == ("one", 2, 0)
        stack.enter_context(
            begun(*connect, "--processes", "1", "--name", "lab1", cwd=tmp_path, program="island_worker")
        )
        followed = coordinator("status", "one", "--follow", *connect, cwd=tmp_path)
        assert followed.returncode == 0, followed.stderr
        assert followed.stdout.splitlines()[-3].startswith("job one done")
        events = json.loads(coordinator("logs", "one", "--json", *connect, cwd=tmp_path).stdout)
        told = [event["event"] for event in events if event["event"] != "log"]
        assert len(told) < len(events)  # what its worker logged of it
        assert told[:2] == ["submitted", "prepared"]
        assert told[-2:] == ["refining", "done"]
        assert told.count("cut") == 2
        (worker,) = json.loads(coordinator("workers", *connect, "--json", cwd=tmp_path).stdout)
        assert worker["counters"]["memory_bytes"] > 10_000_000
        assert {entry["kind"] for entry in worker["counters"]["traffic"]} >= {"status", "report", "blob", "control"}
        serve.send_signal(signal.SIGTERM)
        _, err = finish(serve)
    lines = [json.loads(line) for line in err.splitlines() if line.startswith("{")]
    assert {"started", "submitted", "worker-joined", "placed", "done"} <= {line["event"] for line in lines}
    assert all(line["job"] == "one" for line in lines if line["event"] == "cut")
