"""Same seed, same answer: one search in many ways, and whether its digest is the same in all of them.

``python -m benchmarks.operations.digests`` prints a line per way and ends with 1 when any digest differs from the first
of its group. Searches of one group differ in nothing that may matter: not in the number of workers, in who started
them, in the processor's features that numpy uses, or in the processor that the kernels are compiled for.
"""

import importlib
import itertools
import json
import os
import subprocess
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from atoll.terminal.output import note, say
from atoll_core.errors import AtollError
from atoll_core.signals import raising_interrupts
from benchmarks.harness.command_line import OUT, option, program
from benchmarks.harness.jobs import UNMET
from benchmarks.harness.record import Record
from benchmarks.harness.service import searching
from benchmarks.harness.systems import TABLE_III, trajectories, write_csv
from benchmarks.harness.tables import Columns


@dataclass(frozen=True)
class Way:
    """One way to search: `islands` decides the group; `environment` is laid over this process's."""

    name: str
    islands: int
    workers: int
    environment: tuple[tuple[str, str], ...] = ()
    through: str = "run"


@dataclass(frozen=True)
class Outcome:
    """What came out of one way."""

    system: str
    way: Way
    digest: str
    point_evaluations: int
    seconds: float
    is_same: bool


def ways(cache: Path) -> list[Way]:
    """Return all ways; those of one number of islands must agree. `cache` is for kernels of another processor."""
    plain_numpy = (("NPY_DISABLE_CPU_FEATURES", " ".join(optional_features())),)
    generic = (("NUMBA_CPU_NAME", "generic"), ("ATOLL_KERNEL_CACHE", str(cache)))
    return [
        Way("run, 2 workers", 8, 2),
        Way("run, 2 workers, again", 8, 2),
        Way("run, 1 worker", 8, 1),
        Way("run, 3 workers", 8, 3),
        Way("serve and submit, 2 workers", 8, 2, through="submit"),
        Way("serve and submit, 1 worker", 8, 1, through="submit"),
        Way("numpy without optional features", 8, 2, plain_numpy),
        Way("kernels for a generic processor", 8, 2, generic),
        Way("2 islands, 1 worker", 2, 1),
        Way("2 islands, 2 workers", 2, 2),
        Way("2 islands, 5 workers", 2, 5),
    ]


def optional_features() -> list[str]:
    """Return the processor features that numpy found here beyond those that it was built for."""
    numpy = importlib.import_module("numpy._core._multiarray_umath")  # has no type stubs
    return [name for name in numpy.__cpu_dispatch__ if numpy.__cpu_features__[name]]


def searched(way: Way, data: Path, options: Namespace, folder: Path) -> dict[str, object]:
    """Search `data` in one way, with the seed and within the budget of `options`; raises AtollError."""
    environment = {**os.environ, **dict(way.environment)}
    words = [
        str(data), "--trajectory", "trajectory", "--seed", str(options.seed), "--islands", str(way.islands),
        "--max-epochs", str(options.epochs), "--target-error", str(options.target_error), "--json",
    ]  # fmt: skip
    if way.through == "submit":
        with searching(way.workers, environment) as searches:
            return _command(["submit", *words, "--connect", searches.address], environment)
    with raising_interrupts():
        return _command(["run", *words, "--workers", str(way.workers), "--out", str(folder)], environment)


def _command(words: Sequence[str], environment: dict[str, str]) -> dict[str, object]:
    process = subprocess.Popen(
        [sys.executable, "-m", "atoll", *words],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment, start_new_session=True,
    )  # fmt: skip
    try:
        text, messages = process.communicate()
    except BaseException:
        process.terminate()  # it ends its workers
        process.communicate()
        raise
    if process.returncode not in (0, 4):
        raise AtollError(f"coordinator {words[0]} ended with {process.returncode}: {messages.strip()[-300:]}")
    result: dict[str, object] = json.loads(text)
    return result


def compared(system: str, all_ways: Sequence[Way], search: Callable[[Way], dict[str, object]]) -> list[Outcome]:
    """Search in all ways and compare each digest with the first one of as many islands."""
    first: dict[int, str] = {}
    outcomes = []
    for way in all_ways:
        begun = time.monotonic()
        result = search(way)
        digest = str(result["digest"])
        is_same = digest == first.setdefault(way.islands, digest)
        note(f"{system}, {way.name}: {digest[:16]}{'' if is_same else ' DIFFERS'}")
        evaluations = int(str(result["point_evaluations"]))
        outcomes.append(Outcome(system, way, digest, evaluations, time.monotonic() - begun, is_same))
    return outcomes


def _outcomes(system: str, options: Namespace, folder: Path) -> list[Outcome]:
    data = folder / f"{system}.csv"
    write_csv(data, trajectories(system, options.step, options.seed, options.noise))
    numbers = itertools.count()

    def search(way: Way) -> dict[str, object]:
        return searched(way, data, options, folder / f"{system}-{next(numbers)}")

    return compared(system, ways(folder / "kernels"), search)


COLUMNS: Final = Columns(
    "system | way={way.name} | islands={way.islands} | digest={digest:.16} | ={is_same:same} | "
    "evaluations={point_evaluations:.4e} | s={seconds:.1f}"
)


@program(
    "benchmarks.operations.digests",
    __doc__,
    option("--system", choices=TABLE_III, action="append", help="repeat for several (lotka_volterra)"),
    option("--step", type=float, default=0.1, help="sampling step (%(default)s)"),
    option("--noise", type=float, default=0.0, help="share of each state's deviation (%(default)s)"),
    option("--seed", type=int, default=0, help="of data and search (%(default)s)"),
    option("--epochs", type=int, default=4, help="length of each search (%(default)s)"),
    option("--target-error", type=float, default=UNMET, help="where a search ends (never)"),
    OUT,
)
def main(options: Namespace) -> int:
    """Search in all ways, print the table; return 1 when a digest differs, else 0."""
    outcomes: list[Outcome] = []
    with TemporaryDirectory(prefix="atoll-digests-") as name:
        for system in options.system or ("lotka_volterra",):
            outcomes += _outcomes(system, options, Path(name))
    say(COLUMNS.table(outcomes))
    differing = sum(not outcome.is_same for outcome in outcomes)
    say(f"\n{differing} of {len(outcomes)} digests differ" if differing else "\nthe same digest in every way")
    figures = [
        {
            "system": outcome.system,
            "way": outcome.way.name,
            "islands": outcome.way.islands,
            "digest": outcome.digest,
            "same": outcome.is_same,
        }
        for outcome in outcomes
    ]
    Record("digests", options.words, options.out).write(ways=figures)
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
