"""One structure, constants of each run: are structure, shared and differing constants found?

``python -m benchmarks.known [--seeds 10-19] [--noise 0 0.01 0.05] [--workers N] [--without-search]``

Three runs of one law that differ in growth rates. Each table is searched by a whole job with ``--group run``; or,
without the search, refined in this process from a front that has nothing but a straight line. A law counts as found
when the equation of every run is exact in form, and its values lie within 5 % of the truth's (without noise 0.1 %, with
5 % of noise 15 %), and when exactly the constants that differ in truth are shown to differ. Intervals are those of all
constants of all runs, as fitted. Seeds 0 to 9 are for tuning.
"""

import sys
import time
from argparse import Namespace
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.integrate import solve_ivp

from atoll.terminal.output import note
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.pipeline import refine_all
from atoll_coordinator.model.refinement import Pool
from atoll_coordinator.model.result.result import Account, VariableOutcome, build_result
from atoll_coordinator.service.jobs.defaults import resolve
from atoll_core.config import DataConfig, JobConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.text.parsing import from_infix
from atoll_core.search.pareto import FrontEntry
from benchmarks.harness.command_line import option, program, seeds_of, workers
from benchmarks.harness.jobs import table_of_columns
from benchmarks.harness.service import searching

Rates = Callable[[float, Sequence[float], float], Sequence[float]]
TOLERANCES: Final = {0.0: 0.001, 0.01: 0.05, 0.05: 0.15}


@dataclass(frozen=True)
class Law:
    """A law whose runs differ in one constant: `rates` (t, z, constant), and what its equations are as text.

    `truths` have ``{r}`` where the constant of a run stands; `differ` is the variable of the equation that has it.
    """

    name: str
    states: tuple[str, ...]
    rates: Rates
    truths: dict[str, str]
    differ: str
    constants: tuple[float, ...]
    starts: tuple[tuple[float, ...], ...]
    end: float


LAWS: Final = (
    Law(
        "logistic growth", ("x",), lambda _, z, r: [r * z[0] * (1.0 - z[0] / 2.0)],
        {"x": "{r}*x*(1 - x/2)"}, "x", (0.5, 1.0, 1.7), ((0.1,), (0.2,), (0.05,)), 12.0,
    ),
    Law(
        "Lotka-Volterra", ("x", "y"), lambda _, z, r: [z[0] * (r - 0.9 * z[1]), z[1] * (0.6 * z[0] - 1.1)],
        {"x": "x*({r} - 0.9*y)", "y": "y*(0.6*x - 1.1)"}, "x", (0.8, 1.3, 2.0),
        ((2.0, 1.0), (1.0, 1.0), (3.0, 2.0)), 14.0,
    ),
    Law(
        "Monod uptake", ("s",), lambda _, z, r: [-r * z[0] / (0.7 + z[0])],
        {"s": "-{r}*s/(0.7 + s)"}, "s", (0.4, 0.9, 1.5), ((4.0,), (3.0,), (5.0,)), 6.0,
    ),
)  # fmt: skip
ROWS: Final = 120
HEADS: Final = ("law", "noise", "right in structure", "right constants differ", "intervals hold the truth", "s")


def table(law: Law, noise: float, seed: int) -> Table:
    """Return the runs of a law, one behind the other; `noise` is a share of each state's standard deviation."""
    draw = np.random.default_rng(seed)
    times = np.linspace(0.0, law.end, ROWS)
    runs = [
        solve_ivp(law.rates, (0.0, law.end), start, "DOP853", times, rtol=1e-11, atol=1e-12, args=(constant,)).y
        for constant, start in zip(law.constants, law.starts, strict=True)
    ]
    values = np.concatenate(runs, axis=1)
    values = values + noise * values.std(axis=1)[:, None] * draw.standard_normal(values.shape)
    numbers = np.repeat(np.arange(1.0, len(runs) + 1.0), ROWS)
    columns = {"run": numbers, "t": np.tile(times, len(runs)), **dict(zip(law.states, values, strict=True))}
    return table_of_columns(columns, f"{law.name}.csv")


@dataclass(frozen=True)
class Outcome:
    """Of one job: is the structure right, are the right constants told apart, and how many intervals hold the truth?"""

    is_right: bool
    is_told: bool
    held: int
    intervals: int
    seconds: float


def judged(law: Law, noise: float, result: dict[str, Any]) -> Outcome:
    """Compare a result with the law."""
    draw = np.random.default_rng(5).uniform(0.3, 2.5, (len(law.states), 200))
    tolerance, is_right, is_told, held, intervals = TOLERANCES[noise], True, True, 0, 0
    for equation in result["equations"]:
        shared = [each["shared"] for each in equation["constants"]]
        differs = equation["variable"] == law.differ
        is_told = is_told and shared.count(False) == int(differs)
        groups = equation["groups"]
        is_right = is_right and len(groups) == len(law.constants)
        for group, constant in zip(groups, law.constants, strict=False):
            truth = law.truths[equation["variable"]].format(r=repr(constant))
            is_right = is_right and _is_near(group["expression"], truth, law.states, draw, tolerance)
            for place, its in enumerate(group["constants"]):
                if its["interval"] is not None and (not shared[place] or group is groups[0]):
                    true = _true_value(group["expression"], truth, law.states, draw, place)
                    intervals += true is not None
                    held += true is not None and its["interval"][0] <= true <= its["interval"][1]
    return Outcome(is_right, is_told, held, intervals, float(result["seconds"]))


def _is_near(expression: str, truth: str, names: Sequence[str], points: FloatArray, tolerance: float) -> bool:
    """Tell whether an expression with its constants refitted to the truth is the truth, and was near it before."""
    refitted = _refitted(expression, truth, names, points)
    values, right = values_of(from_infix(expression, names), points), values_of(from_infix(truth, names), points)
    size = float(np.sqrt(np.mean(right**2)))
    is_same = refitted is not None and bool(np.sqrt(np.mean((refitted[1] - right) ** 2)) <= 1e-7 * size)
    return is_same and bool(np.sqrt(np.mean((values - right) ** 2)) <= tolerance * size)


def _refitted(
    expression: str, truth: str, names: Sequence[str], points: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Return the constants with which an expression comes nearest to the truth, and its values."""
    from atoll_coordinator.model.regression.fit import LeastSquares
    from atoll_core.data.dataset import Problem, Target
    from atoll_core.expression.program import constant_places

    right = values_of(from_infix(truth, names), points)
    problem = Problem(tuple(names), np.ascontiguousarray(points), Target("", "", right, 0.0, 1.0))
    fitted = LeastSquares(problem).fit(from_infix(expression, names)).program
    values = values_of(fitted, points)
    return (fitted.constants[constant_places(fitted)], values) if np.isfinite(values).all() else None


def _true_value(expression: str, truth: str, names: Sequence[str], points: FloatArray, place: int) -> float | None:
    """Return what a constant of the expression is in truth, None where the expression is another."""
    found = _refitted(expression, truth, names, points)
    right = values_of(from_infix(truth, names), points)
    if found is None or np.sqrt(np.mean((found[1] - right) ** 2)) > 1e-7 * np.sqrt(np.mean(right**2)):
        return None
    return float(found[0][place]) if place < len(found[0]) else None


Solve = Callable[[str, Table, JobConfig], dict[str, Any]]
"""Makes a result of a table; the first argument is its name for people."""


def refined(name: str, its: Table, config: JobConfig) -> dict[str, Any]:
    """Return the result of a table whose search has found nothing but straight lines."""
    start = time.process_time()
    preparation = prepare(its, config)
    config = resolve(config, preparation.dataset)
    pools = {}
    for variable in preparation.dataset.variables:
        line = from_infix(variable, preparation.dataset.names)
        pools[variable] = Pool((FrontEntry(1, 1.0, 1.0, 0, 1, 0, line.to_bytes()),))
    refinement = refine_all(preparation, config, pools)
    outcomes = [
        VariableOutcome(variable, pools[variable].front, 1, refined=refinement.equations.get(variable))
        for variable in preparation.dataset.variables
    ]
    account = Account("done", time.process_time() - start, 0.0)
    return build_result(name, config, preparation, outcomes, account, refinement).as_dict()


def measure(solve: Solve, law: Law, noise: float, seed: int) -> Outcome:
    """Search one table and judge what comes out."""
    config = JobConfig(seed=seed, data=DataConfig(group="run"))
    result = solve(f"{law.name} {noise:g} {seed}", table(law, noise, seed), config)
    outcome = judged(law, noise, result)
    texts = "; ".join(f"{equation['lhs']} = {equation['expression']}" for equation in result["equations"])
    note(f"{law.name}, noise {noise:g}, seed {seed}: {outcome} {texts}")
    return outcome


def rows(solve: Solve, options: Namespace) -> list[str]:
    """Return a line of the table for each law and noise."""
    lines = []
    for law in LAWS[: options.laws]:
        for noise in options.noise:
            chosen = options.seeds if noise else options.seeds[:1]
            found = [measure(solve, law, noise, seed) for seed in chosen]
            right, told = sum(each.is_right for each in found), sum(each.is_told for each in found)
            held, intervals = sum(each.held for each in found), sum(each.intervals for each in found)
            seconds = float(np.median([each.seconds for each in found]))
            lines.append(
                f"| {law.name} | {100 * noise:g} % | {right} of {len(found)} | {told} of {len(found)} | "
                f"{held} of {intervals} | {seconds:.0f} |"
            )
            note(lines[-1])
    return lines


@program(
    "benchmarks.known",
    __doc__,
    seeds_of("10-19", "such as 0-9 (10-19)"),
    option("--noise", type=float, nargs="+", default=sorted(TOLERANCES)),
    workers(1),
    option("--laws", type=int, default=len(LAWS), help="so many of the laws, the first ones"),
    option("--without-search", action="store_true", help="refine in this process, seconds of its processor"),
    prog=None,
)
def main(options: Namespace) -> int:
    """Run the benchmark and print its table."""
    if options.without_search:
        lines = rows(refined, options)
    else:
        with searching(options.workers) as searches:
            lines = rows(searches.solve, options)
    sys.stdout.write("\n".join([f"| {' | '.join(HEADS)} |", "|---" * len(HEADS) + "|", *lines]) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
