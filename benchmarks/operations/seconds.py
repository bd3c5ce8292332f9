"""Where the seconds of ``coordinator run`` go: start-up, search and refining of tables that are a user's first try.

``python -m benchmarks.operations.seconds`` simulates the tables, runs the command on each, and prints wall seconds by
phase as the command tells them, the processor seconds of all its processes, and what was found. Kernels and modules
should have been compiled before (``make demo``); bytecode is written whatever the environment says. Wall seconds depend
on what else the machine does; processor seconds hardly.
"""

import json
import os
import re
import subprocess
import sys
from argparse import Namespace
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
import polars
from scipy.integrate import solve_ivp

from atoll.terminal.output import say, table
from atoll_core.errors import AtollError
from benchmarks.harness.command_line import OUT, option, program
from benchmarks.harness.record import Record, load

EXAMPLE: Final = Path(__file__).parents[2] / "examples" / "lotka_volterra.csv"
LIMIT_S: Final = 600.0

_PHASE: Final = re.compile(r"(start-up|compiling kernels|loading kernels|search|refining|total) ((?:\d+:)*[\d.]+)")

Rates = Callable[[float, Sequence[float]], list[float]]


@dataclass(frozen=True)
class Case:
    """A table that is simulated: `noise` is a share of each state's deviation, `solver` goes to `solve_ivp`."""

    rates: Rates
    start: tuple[float, ...]
    duration: float
    rows: int
    solver: dict[str, Any]
    noise: float = 0.0


def logistic(_: float, x: Sequence[float]) -> list[float]:
    """x' = 0.79 x (1 - x/74.3)."""
    return [0.79 * x[0] * (1.0 - x[0] / 74.3)]


def lotka(_: float, x: Sequence[float]) -> list[float]:
    """x' = 1.1 x - 0.4 x y, y' = 0.1 x y - 0.4 y."""
    return [1.1 * x[0] - 0.4 * x[0] * x[1], 0.1 * x[0] * x[1] - 0.4 * x[1]]


def lorenz(_: float, x: Sequence[float]) -> list[float]:
    """Lorenz's equations with the constants of his paper (1963)."""
    return [10.0 * (x[1] - x[0]), x[0] * (28.0 - x[2]) - x[1], x[0] * x[1] - 8.0 / 3.0 * x[2]]


_LSODA: Final = {"method": "LSODA", "rtol": 1e-7}
CASES: Final[dict[str, Case | None]] = {
    "example": None,
    "logistic, RK45 default": Case(logistic, (7.3,), 10.0, 150, {}),
    "logistic, RK45 1e-6": Case(logistic, (7.3,), 10.0, 150, {"rtol": 1e-6}),
    "lotka, LSODA 1e-7": Case(lotka, (10.0, 5.0), 40.0, 200, _LSODA),
    "lotka, 1 % noise": Case(lotka, (10.0, 5.0), 40.0, 200, _LSODA, 0.01),
    "lotka, 5 % noise": Case(lotka, (10.0, 5.0), 40.0, 200, _LSODA, 0.05),
    "lotka, 100,000 rows": Case(lotka, (10.0, 5.0), 400.0, 100_000, _LSODA),
    "lotka, 100,000 rows, 1 % noise": Case(lotka, (10.0, 5.0), 400.0, 100_000, _LSODA, 0.01),
    "lorenz, RK45 1e-6": Case(lorenz, (1.0, 1.0, 1.0), 20.0, 1_000, {"rtol": 1e-6}),
}
"""By name; None: the example that comes with Atoll."""


def write(case: Case, file: Path) -> None:
    """Write what `case` measures."""
    times = np.linspace(0.0, case.duration, case.rows)
    values = solve_ivp(case.rates, (0.0, case.duration), case.start, t_eval=times, **case.solver).y
    values = values + case.noise * values.std(axis=1, keepdims=True) * np.random.default_rng(1).normal(
        size=values.shape
    )
    columns = dict(zip("xyz", values, strict=False))
    polars.DataFrame({"t": times, **columns}).write_csv(file)


def seconds_of(text: str) -> float:
    """Return the seconds of a duration such as 1.2 or 1:02."""
    total = 0.0
    for part in text.split(":"):
        total = 60.0 * total + float(part)
    return total


def run(name: str, case: Case | None, folder: Path) -> dict[str, Any]:
    """Run the command on one table; return its phases, processor seconds and equations; raises AtollError."""
    data, out = EXAMPLE, folder / "out"
    if case is not None:
        data = folder / "data.csv"
        write(case, data)
    words = [sys.executable, "-m", "atoll", "run", str(data), "--out", str(out)]
    environment = {each: value for each, value in os.environ.items() if each != "PYTHONDONTWRITEBYTECODE"}
    before = os.times()
    done = subprocess.run(words, capture_output=True, text=True, timeout=LIMIT_S, check=False, env=environment)
    after = os.times()
    if done.returncode:
        raise AtollError(f"{name} ended with exit code {done.returncode}: {done.stderr.strip()[-300:]}")
    told = done.stderr.strip().splitlines()[-2]
    result = json.loads((out / "result.json").read_text("utf-8"))
    return {
        "case": name,
        **{phase: seconds_of(value) for phase, value in _PHASE.findall(told)},
        "wall": after.elapsed - before.elapsed,
        "processor": after.children_user + after.children_system - before.children_user - before.children_system,
        "equations": [f"{equation['expression']} ({equation['verdict']})" for equation in result["equations"]],
    }


@program(
    "benchmarks.operations.seconds",
    __doc__,
    option("cases", nargs="*", default=list(CASES), help=f"of {', '.join(CASES)} (default: all)"),
    OUT,
)
def main(options: Namespace) -> int:
    """Measure and print."""
    rows = []
    for name in options.cases:
        if name not in CASES:
            raise AtollError(f"there is no case {name!r}; choose from {', '.join(CASES)}")
        with TemporaryDirectory(prefix="atoll-benchmark-") as folder:
            rows.append(run(name, CASES[name], Path(folder)))
        say(f"{name}: {'; '.join(rows[-1]['equations'])}")
    Record("seconds", options.words, options.out).write(rows=rows)
    heads = ("start-up", "search", "refining", "total", "wall", "processor")
    say(table(("table", *heads), [(row["case"], *(f"{row.get(head, 0.0):.1f}" for head in heads)) for row in rows]))
    say(f"\nload {load():.1f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
