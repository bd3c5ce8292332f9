"""From real measurements to equations: what is shown, what is said of it, and after how long.

``python -m benchmarks.real --data DIR`` searches each of the cases with two workers and prints the equations, their
constants with 95 % intervals, their verdicts, R2 of the simulated trajectories, and seconds.
"""

import os
import sys
from argparse import Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from atoll.terminal.output import say
from atoll_core.errors import AtollError
from benchmarks.harness.campaign import attempt
from benchmarks.harness.command_line import option, positive, program, workers
from benchmarks.harness.record import Record
from benchmarks.harness.service import Searches, searching
from benchmarks.harness.stopwatch import Stopwatch
from benchmarks.real.cases import CASES, Case

FOLDER: Final = os.environ.get("ATOLL_REAL_DATA")


def run(searches: Searches, case: Case, options: Namespace) -> dict[str, Any]:
    """Search one case and return what came of it."""
    stopwatch = Stopwatch()
    try:
        table = case.table(options.data)
    except AtollError as error:
        return {"case": case.name, "seconds": 0.0, "failure": str(error)}
    job = attempt(searches, case.name, table, case.config(options.seed, options.max_time), stopwatch)
    told = {"phases": stopwatch.seconds, **summarized(job.result)} if job.failure is None else {"failure": job.failure}
    return {"case": case.name, "seconds": job.seconds, **told}


def summarized(result: Mapping[str, Any]) -> dict[str, Any]:
    """Return what is shown of a result: equations, constants, verdicts, simulations, noise, warnings."""
    simulation = result["simulation"] or {"trajectories": []}
    keys = ("lhs", "expression", "constants", "verdict", "reason", "complexity")
    return {
        "equations": [{key: equation[key] for key in keys} for equation in result["equations"]],
        "r2": {trajectory["name"]: trajectory["r2"] for trajectory in simulation["trajectories"]},
        "noise": {state: noise["relative"] for state, noise in result["noise"].items()},
        "warnings": result["warnings"],
    }


def lines(case: Mapping[str, Any]) -> list[str]:
    """Return one case as text."""
    if "failure" in case:
        return [f"{case['case']}: {case['failure']} ({case['seconds']:.0f} s)"]
    text_lines = [f"{case['case']}, {case['seconds']:.0f} s"]
    for equation in case["equations"]:
        text_lines.append(f"  {equation['lhs']} = {equation['expression']}")
        text_lines += [f"    {_interval(constant)}" for constant in equation["constants"]]
        text_lines.append(f"    {equation['verdict']}: {equation['reason']}")
    return [*text_lines, f"  R2: {case['r2']}", *(f"  warning: {warning}" for warning in case["warnings"])]


def _interval(constant: Mapping[str, Any]) -> str:
    low, high = constant["interval"] or (None, None)
    bounds = "no interval" if low is None or high is None else f"{low:.5g} to {high:.5g}"
    return f"{constant['value']:.6g}: {bounds}"


@program(
    "benchmarks.real",
    __doc__,
    option(
        "--data",
        type=Path,
        metavar="DIR",
        required=FOLDER is None,
        help="folder of the files",
        default=None if FOLDER is None else Path(FOLDER),
    ),
    option("--cases", nargs="+", help="parts of the names of cases; default: all"),
    option("--seed", type=int, default=0, help="%(default)s"),
    workers(),
    option("--max-time", type=positive, metavar="SECONDS", help="end of a job; default: none"),
    option("--json", type=Path, metavar="FILE", help="file for the figures as JSON"),
)
def main(options: Namespace) -> int:
    """Search all cases, or those asked for."""
    with searching(options.workers) as searches:
        rows = []
        for case in CASES:
            if not options.cases or any(word in case.name for word in options.cases):
                rows.append(run(searches, case, options))
                say("\n".join(lines(rows[-1])))
                Record("real", options.words, options.json).write(rows=rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
