"""The second mistake, on the programs of the checkout: what is still there after a repair that went wrong."""

import json
import os
import signal
import subprocess
from collections.abc import Sequence
from pathlib import Path

from deploy.rehearsal import job
from deploy.rehearsal.machine import FailedError, Machine, free_port, wait_until

WORKER = str(Path(job.PROGRAM).with_name("island-worker"))
STORE = "atoll.sqlite3"
FULL = 1
"""Exit code of ``coordinator serve`` for what may pass; 2 would keep a service of systemd down."""


def rehearse_mistakes(machine: Machine) -> str:
    """Kill a coordinator and all workers, and start what an operator would start first; return what was done."""
    folder = machine.work / f"mistakes-{machine.id}"
    folder.mkdir()
    address = f"tcp/127.0.0.1:{free_port()}"
    state = folder / "state"
    coordinator, worker = _serve(machine, address, state), _work(machine, address)
    machine.run(job.PROGRAM, "submit", str(job.DATA), *job.OPTIONS, "--no-wait", "--connect", address, timeout=120)
    job.wait_until_under_way(machine, 1, address)
    machine.run(job.PROGRAM, "queue", "pause", "--connect", address)
    machine.run(job.PROGRAM, "submit", str(job.DATA), *job.OPTIONS, "--no-wait", "--connect", address)
    copy = folder / "copy.sqlite3"
    machine.run(job.PROGRAM, "backup", str(copy), "--state", str(state))
    _kill(coordinator, worker)

    coordinator = _serve(machine, address, state)  # paused, killed, and started: no worker yet
    found = _jobs(machine, address)
    if [each["state"] for each in found] != ["running", "queued"] or not _has_equations(found[0]):
        raise FailedError(f"one job with its equations and one that waits were expected, but {found} were found")
    _kill(coordinator)

    full = ["sh", "-c", 'ulimit -f 1; exec "$@"', "sh", *_words(address, state)]
    ended = machine.run(*full, check=False)
    if ended.returncode != FULL:
        raise FailedError(f"on a full disk the coordinator ended with {ended.returncode}, but {FULL} was expected")

    (state / STORE).write_bytes(b"damaged")  # damaged, moved away without its WAL, restored, served
    (state / STORE).rename(folder / "damaged.sqlite3")
    restored = json.loads(machine.run(job.PROGRAM, "restore", str(copy), "--state", str(state), "--json").stdout)
    coordinator, worker = _serve(machine, address, state), _work(machine, address)
    wait_until("the job that had begun goes on under the paused queue", lambda: _ends(machine, address), job.LIMIT_S)
    states = [each["state"] for each in _jobs(machine, address)]
    if restored["jobs"] != 2 or states != ["done", "queued"]:
        raise FailedError(f"2 jobs, done and queued, were expected, but {restored['jobs']} were restored: {states}")
    coordinator.send_signal(signal.SIGTERM)
    if coordinator.wait(60) != 0:
        raise FailedError(
            f"the coordinator ended with {coordinator.returncode}, but 0 was expected; see {machine.logs}"
        )
    if worker.poll() is not None:
        raise FailedError(f"the worker ended with {worker.returncode}, but was expected to wait for the coordinator")
    _kill(worker)
    return "paused and killed, full, damaged, moved, restored: no job and no equation was lost"


def _words(address: str, state: Path) -> Sequence[str]:
    return (job.PROGRAM, "serve", "--listen", address, "--state", str(state))


def _serve(machine: Machine, address: str, state: Path) -> "subprocess.Popen[bytes]":
    started = machine.start("mistakes-coordinator", *_words(address, state))
    ping = (job.PROGRAM, "ping", "--connect", address)
    wait_until("the coordinator answers", lambda: machine.run(*ping, check=False).returncode == 0)
    return started


def _work(machine: Machine, address: str) -> "subprocess.Popen[bytes]":
    """Start one worker as `serve` prints it."""
    return machine.start("mistakes-worker", WORKER, "--connect", address, "--processes", "1")


def _jobs(machine: Machine, address: str) -> list[dict[str, object]]:
    return job.ask(machine, "jobs", address)


def _has_equations(view: dict[str, object]) -> bool:
    variables = view["variables"]
    return isinstance(variables, list) and bool(variables) and all(each["expression"] for each in variables)


def _ends(machine: Machine, address: str) -> bool:
    return any(each["state"] == "done" for each in _jobs(machine, address))


def _kill(*started: "subprocess.Popen[bytes]") -> None:
    for each in started:
        os.killpg(each.pid, signal.SIGKILL)
        each.wait(30)
