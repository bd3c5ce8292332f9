"""The job that every step runs: a table of 21 rows, searched for long enough to kill a worker meanwhile."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from deploy.rehearsal.machine import ROOT, FailedError, Machine, wait_until

PROGRAM = str(Path(sys.executable).with_name("coordinator"))
"""The checkout's own."""
DATA = ROOT / "examples" / "lynx_hare.csv"
OPTIONS = ("--time", "year", "--preset", "paper", "--max-epochs", "400", "--seed", "3")
EARLY = 20
"""Epochs after which workers are killed or the job is cut off: with many still to come."""
LIMIT_S = 900.0
UNREACHABLE = 3
"""Exit code of ``coordinator`` when no coordinator answers."""


def check_digest(machine: Machine, out: Path) -> None:
    """Compare a result with that of ``coordinator run`` of the checkout, found once a rehearsal; raises FailedError."""
    reference = machine.work / f"reference-{machine.id}"
    if not reference.exists():
        words = (PROGRAM, "run", str(DATA), *OPTIONS, "--workers", "2", "--out", str(reference))
        machine.run(*words, timeout=LIMIT_S)
    if not (out / "result.json").exists():
        raise FailedError(f"{out / 'result.json'} was expected and is not there")
    found, expected = (json.loads((each / "result.json").read_text("utf-8"))["digest"] for each in (out, reference))
    if found != expected:
        raise FailedError(f"the result has digest {found[:16]}, but {expected[:16]} was expected")


def check_submitted(machine: Machine, submitting: subprocess.Popen[bytes], out: Path) -> None:
    """Wait for a ``coordinator submit`` to end well, and compare its digest; raises FailedError."""
    if submitting.wait(LIMIT_S) != 0:
        raise FailedError(f"coordinator submit ended with {submitting.returncode}; see {machine.logs}")
    check_digest(machine, out)


def ask(machine: Machine, verb: str, *where: str) -> list[dict[str, Any]]:
    """Return what ``coordinator jobs`` or ``coordinator workers`` answers, nothing if no coordinator is there.

    `where` is its address, and options that name certificates for it.
    """
    done = machine.run(PROGRAM, verb, "--connect", *where, "--json", check=False)
    if done.returncode not in (0, UNREACHABLE):
        raise FailedError(f"coordinator {verb} ended with {done.returncode}: {done.stderr.strip()}")
    return list(json.loads(done.stdout)) if done.returncode == 0 else []


def computing(machine: Machine, *where: str) -> set[str]:
    """Return the names of the workers that have islands."""
    return {each["worker"] for each in ask(machine, "workers", *where) if each["islands"]}


def wait_until_under_way(machine: Machine, workers: int, *where: str) -> set[str]:
    """Wait until the only job has come to epoch `EARLY` with so many workers computing; return their names."""

    def is_under_way() -> bool:
        jobs = ask(machine, "jobs", *where)
        if any(job["state"] not in ("queued", "preparing", "running") for job in jobs):
            raise FailedError("the job ended before a worker could be killed; give it more epochs")
        is_early = any(job["variables"] and min(each["epoch"] for each in job["variables"]) >= EARLY for job in jobs)
        return is_early and len(computing(machine, *where)) == workers

    wait_until(f"{workers} workers compute", is_under_way, LIMIT_S)
    return computing(machine, *where)
