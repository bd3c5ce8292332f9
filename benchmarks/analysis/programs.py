"""How long imports, calls and commands take from outside, what they find, and what they leave behind."""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from benchmarks.analysis.check import Check, same, seconds
from benchmarks.harness.service import searching

PART: Final = "programs"
DATA: Final = Path(__file__).resolve().parents[2] / "examples" / "lotka_volterra.csv"
_SIX_LINES: Final = """
import atoll
model = atoll.discover({data!r})
print(model)
print(model.params["c1"])
print(model.equations[0].verdict)
print(model.provenance["digest"])
"""
_CALLS: Final = """
import json, os, sys, threading, time
import atoll

def left():
    tasks = [len(os.listdir("/proc/self/task")), threading.active_count()]
    children = [pid for pid in os.listdir("/proc") if pid.isdigit() and _parent(pid) == os.getpid()]
    return [*tasks, len(os.listdir("/proc/self/fd")), len(children), len(os.listdir("."))]

def _parent(number):
    try:
        with open(f"/proc/{number}/stat") as file:
            return int(file.read().rpartition(")")[2].split()[1])
    except OSError:
        return 0

def call():
    began = time.monotonic()
    model = atoll.discover(sys.argv[1])
    return time.monotonic() - began, model.provenance["digest"]

first, second = call(), call()
before, times, digests = left(), [second[0]], {first[1], second[1]}
for _ in range(int(sys.argv[2])):
    took, digest = call()
    times.append(took)
    digests.add(digest)
end = time.monotonic() + 30.0
while (after := left()) != before and time.monotonic() < end:  # threads of the bus that are idle end after a while
    time.sleep(0.5)
print(json.dumps({"first": first[0], "times": times, "digests": sorted(digests), "before": before, "after": after}))
"""


def checks(calls: int, repeats: int) -> Iterator[Check]:
    """Yield the times of so many `repeats`, and what so many `calls` in one interpreter leave behind."""
    yield from _times("import atoll", 0.3, [sys.executable, "-c", "import atoll"], repeats, Path.cwd())
    yield from _times("coordinator --help", 0.3, [sys.executable, "-m", "atoll", "--help"], repeats, Path.cwd())
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        script = [sys.executable, "-c", _SIX_LINES.format(data=str(DATA))]
        _run(script, place)  # compiles what is not yet
        yield from _times("six lines find Lotka-Volterra, whole interpreter", 5.0, script, repeats, place)
        figures = json.loads(_run([sys.executable, "-c", _CALLS, str(DATA), str(calls)], place))
        yield from _calls(figures, calls)
        run = _digest_of([sys.executable, "-m", "atoll", "run", str(DATA), "--out", "run"], place / "run")
        submit = _submitted(place)
        digests = {*figures["digests"], run, submit}
        yield same(PART, "digests of the API, of run and of submit", len(digests), 1, "one seed, one answer")


def _calls(figures: dict[str, Any], calls: int) -> Iterator[Check]:
    yield seconds(PART, "first call", [figures["first"]], None)
    yield seconds(PART, "second call", figures["times"][:1], 1.0)
    yield seconds(PART, f"{calls} further calls, each", figures["times"][1:], 1.0)
    what = "tasks, threads of Python, open files, child processes, files in the folder"
    yield same(PART, f"after {calls} calls: {what}", figures["after"], figures["before"], "as before them")


def _times(quantity: str, limit: float, words: list[str], repeats: int, place: Path) -> Iterator[Check]:
    """Yield the wall times of a command, and the processor time of all of its processes."""
    wall, processor = [], []
    for _ in range(repeats):
        began, spent = time.monotonic(), _spent()
        _run(words, place)
        wall.append(time.monotonic() - began)
        processor.append(_spent() - spent)
    yield seconds(PART, quantity, wall, limit)
    yield seconds(PART, f"{quantity}: processor time", processor, None)


def _spent() -> float:
    """Return the processor time of all processes that have ended below this one."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _run(words: list[str], place: Path) -> str:
    done = subprocess.run(words, cwd=place, env=os.environ, capture_output=True, text=True, check=True)
    return done.stdout


def _digest_of(words: list[str], folder: Path) -> str:
    _run(words, folder.parent)
    return str(json.loads((folder / "result.json").read_text("utf-8"))["digest"])


def _submitted(place: Path) -> str:
    """Return the digest of a job that is submitted to a coordinator with one worker."""
    with searching(1) as searches:
        submit = [sys.executable, "-m", "atoll", "submit", str(DATA), "--connect", searches.address]
        return _digest_of([*submit, "--out", "submitted"], place / "submitted")
