"""From real measurements to equations: what is shown, what is said of it, and after how long.

``python -m benchmarks.real --data DIR`` searches each of the cases with two workers and prints the equations, their
constants with 95 % intervals, their verdicts, R2 of the simulated trajectories, and seconds.
"""

import argparse
import os
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from atoll.errors import AtollError
from atoll_coordinator.cli.terminal.output import say
from benchmarks.harness.command_line import plain_errors, positive, whole
from benchmarks.harness.record import Record
from benchmarks.harness.service import Searches, searching
from benchmarks.harness.stopwatch import Stopwatch
from benchmarks.real.cases import CASES, Case


def run(searches: Searches, case: Case, options: argparse.Namespace) -> dict[str, Any]:
    """Search one case and return what came of it."""
    stopwatch, begun = Stopwatch(), time.monotonic()
    its: dict[str, Any] = {"case": case.name}
    try:
        config = case.config(options.seed, options.max_time)
        result = searches.solve(case.name, case.table(options.data), config, stopwatch.watch)
    except AtollError as error:
        searches.check()
        return {**its, "seconds": time.monotonic() - begun, "failure": str(error)}
    return {**its, "seconds": time.monotonic() - begun, "phases": stopwatch.seconds, **summarized(result)}


def summarized(result: Mapping[str, Any]) -> dict[str, Any]:
    """Return what is shown of a result: equations, constants, verdicts, simulations, noise, warnings."""
    simulation = result["simulation"] or {"trajectories": []}
    keys = ("lhs", "expression", "constants", "verdict", "reason", "complexity")
    return {
        "equations": [{key: equation[key] for key in keys} for equation in result["equations"]],
        "r2": {each["name"]: each["r2"] for each in simulation["trajectories"]},
        "noise": {state: its["relative"] for state, its in result["noise"].items()},
        "warnings": result["warnings"],
    }


def lines(its: Mapping[str, Any]) -> list[str]:
    """Return one case as text."""
    if "failure" in its:
        return [f"{its['case']}: {its['failure']} ({its['seconds']:.0f} s)"]
    found = [f"{its['case']}, {its['seconds']:.0f} s"]
    for equation in its["equations"]:
        found.append(f"  {equation['lhs']} = {equation['expression']}")
        found += [f"    {_interval(constant)}" for constant in equation["constants"]]
        found.append(f"    {equation['verdict']}: {equation['reason']}")
    return [*found, f"  R2: {its['r2']}", *(f"  warning: {each}" for each in its["warnings"])]


def _interval(constant: Mapping[str, Any]) -> str:
    low, high = constant["interval"] or (None, None)
    bounds = "no interval" if low is None or high is None else f"{low:.5g} to {high:.5g}"
    return f"{constant['value']:.6g}: {bounds}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Search all cases, or those asked for."""
    words = sys.argv[1:] if arguments is None else arguments
    options = _parser().parse_args(words)
    with plain_errors("benchmarks.real"), searching(options.workers) as searches:
        rows = []
        for case in CASES:
            if not options.cases or any(word in case.name for word in options.cases):
                rows.append(run(searches, case, options))
                say("\n".join(lines(rows[-1])))
                Record("real", words, options.json).write(rows=rows)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.real", description=__doc__.split("\n")[0])
    folder = os.environ.get("ATOLL_REAL_DATA")
    parser.add_argument("--data", type=Path, metavar="DIR", required=folder is None, help="folder of the files",
                        default=None if folder is None else Path(folder))  # fmt: skip
    parser.add_argument("--cases", nargs="+", help="parts of the names of cases; default: all")
    parser.add_argument("--seed", type=int, default=0, help="%(default)s")
    parser.add_argument("--workers", type=whole, default=2, help="worker processes (%(default)s)")
    parser.add_argument("--max-time", type=positive, metavar="SECONDS", help="end of a job; default: none")
    parser.add_argument("--json", type=Path, metavar="FILE", help="file for the figures as JSON")
    return parser


if __name__ == "__main__":
    sys.exit(main())
