"""Runs of Tables I and III under readings of the paper: what each reading changes, and one search until it converges.

A reading is a set of fields of the configuration. Those that change one thing have a name; several are joined by `+`,
and what comes later wins. All of them begin from preset ``paper``, the reading under which most figures come out (ADR
0042). What it was chosen among and cannot be set any more, revision 0047528d still measures; journals of that time are
of other readings, though names are alike.
"""

import pickle
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from atoll_core import ENGINE_REVISION
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Problem, Target
from atoll_core.errors import UsageError
from atoll_core.expression.program import Program
from atoll_core.expression.text.infix import to_infix
from atoll_core.search.pareto import FrontEntry
from benchmarks.harness.systems import RUNS, SYSTEMS, TRUTH, Draw, Sampled, drawn, trajectories
from benchmarks.judging.forms import compare
from benchmarks.paper.archipelago import Archipelago, configured, problem_of
from benchmarks.paper.published import FRESH, ROWS
from benchmarks.paper.table1 import converged
from benchmarks.paper.table3 import EQUATIONS, STEP

Changes = Mapping[str, Mapping[str, Any]]

READINGS: Final[Mapping[str, Changes]] = {
    "paper": {},
    "relative": {"evolution": {"constant_steps": "relative"}},
    "moved": {"evolution": {"constant_moves": 1.0}},
    "scaled": {"evolution": {"scaled_constants": True}},
    "nodes32": {"space": {"operator_nodes": 32}},
    "all-rows": {"predictors": {"enabled": False}},
    "rows4": {"predictors": {"rows": 4}},
    "rows8": {"predictors": {"rows": 8}},
    "trainers": {"predictors": {"predictors": 8, "trainers": 10, "renewal": 100}},
    "rare-renewal": {"predictors": {"renewal": 50}},
    "effort": {"predictors": {"effort": 0.2}},
    "difference": {"predictors": {"agreement": "difference"}},
    "seldom": {"migration": {"generations": 10_000}},
    "near": {},
}
"""By name, what each changes in preset ``paper``; `near` changes the data instead, see `NEAR`."""


def _near_a_node(rng: np.random.Generator) -> tuple[float, float]:
    """Return a point in the first quadrant, a normal step from one of the stable nodes (3, 0) and (0, 2)."""
    x, y = ((3.0, 0.0), (0.0, 2.0))[int(rng.integers(2))]
    return abs(x + rng.standard_normal()), abs(y + rng.standard_normal())


NEAR: Final[Mapping[str, Draw]] = {
    "lotka_volterra": _near_a_node,
    "van_der_pol": lambda rng: (rng.uniform(-2.0, 2.0), rng.uniform(-2.0 / 3.0, 2.0 / 3.0)),
}
"""Initial conditions about the stable nodes and in the range of the limit cycle, where those of `SYSTEMS`, taken from
published data files, are elsewhere: transients of great size, or one branch of the cycle."""

CLOSE: Final = 0.03
"""Normalized error below which an equation of Table III is compared with the truth."""

UNREACHABLE: Final = 1e-300
"""A normalized error that no island meets: the benchmark ends a run, not the search."""

KEPT_EVERY_S: Final = 60.0
"""Seconds from one time that the state of a run is kept to the next."""

STRIDE: Final = 10
"""Generations of one island between two looks at its front in Table III."""


@dataclass(frozen=True)
class Task:
    """One run: a reading, a row of Table I or an equation of Table III, a seed and a budget of point evaluations."""

    reading: str
    problem: str
    seed: int
    budget: int


@dataclass(frozen=True)
class Run:
    """How it ended: `cost` is the point evaluations until it converged, None when the budget was used up before.

    `seconds` are those of the processor, `error` the least normalized error on all rows at the end.
    """

    task: Task
    cost: int | None
    evaluations: int
    seconds: float
    error: float
    expression: str | None

    @property
    def key(self) -> Task:
        """What was run."""
        return self.task


@dataclass(frozen=True)
class Saved:
    """A run between two epochs: the islands (None: at its beginning), the least error and the seconds so far."""

    states: list[bytes] | None = None
    least: float = np.inf
    seconds: float = 0.0


def config_of(reading: str, seed: int, operators: tuple[str, ...], **evolution: Any) -> JobConfig:
    """Return the configuration of a run; `evolution` replaces what the reading says.

    Raises:
        UsageError: there is no such reading.
    """
    config = configured("paper", seed, operators, UNREACHABLE)
    for changes in (*(_reading(name) for name in reading.split("+")), {"evolution": evolution}):
        update = {group: getattr(config, group).model_copy(update=dict(fields)) for group, fields in changes.items()}
        config = config.model_copy(update=update)
    return config


def _reading(name: str) -> Changes:
    if name not in READINGS:
        raise UsageError(f"there is no reading {name!r}; the readings are {', '.join(READINGS)}, joined by +")
    return READINGS[name]


def run(task: Task, folder: Path | None = None) -> Run:
    """Search until convergence or the end of the budget. Pure but for the seconds: the task decides the rest.

    With a `folder`, a run that takes long leaves its state there from time to time, and goes on from it when it is
    called again, also with a larger budget.
    """
    began = time.process_time()
    of = _of_table1 if task.problem in ROWS else _of_table3
    file = None if folder is None else folder / f"{_named(task)}.pickle"
    saved = pickle.loads(file.read_bytes()) if file is not None and file.exists() else Saved()
    archipelago, stride, is_right = of(task, saved.states)
    began -= saved.seconds
    least, evaluations, cost, expression = saved.least, 0, None, None
    kept_at = time.monotonic()

    def keep() -> None:
        nonlocal kept_at
        if file is not None and time.monotonic() - kept_at > KEPT_EVERY_S:
            kept_at = time.monotonic()
            state = Saved(archipelago.states(), float(least), time.process_time() - began)
            file.with_suffix(".new").write_bytes(pickle.dumps(state))
            file.with_suffix(".new").replace(file)

    for each in archipelago.strides(stride, keep):
        if each.evaluations > task.budget:
            break
        evaluations = each.evaluations
        least = min((least, *(entry.error for entry in each.additions)))
        expression = next((text for text in map(is_right, each.additions) if text is not None), None)
        if expression is not None:
            cost = evaluations
            break
    if file is not None and cost is not None:
        file.unlink(missing_ok=True)
    seconds = time.process_time() - began
    return Run(task, cost, evaluations, seconds, float(least / archipelago.deviation), expression)


def _named(task: Task) -> str:
    return f"{task.reading}-{task.problem}-{task.seed}-engine-{ENGINE_REVISION}".replace(" ", "-")


Judge = Callable[[FrontEntry], str | None]


def _of_table1(task: Task, states: Sequence[bytes] | None) -> tuple[Archipelago, int, Judge]:
    """Return the search for a row of Table I, and what writes down a program that is right at fresh points."""
    row = ROWS[task.problem]
    x, fresh = row.points(task.seed, "points", row.rows), row.points(task.seed, "fresh points", FRESH)
    config = config_of(task.reading, task.seed, row.operators, islands=row.islands, refit_interval=row.interval)

    def is_right(entry: FrontEntry) -> str | None:
        program = converged(row, entry, x, fresh)
        return None if program is None else to_infix(program, ("x",))

    return Archipelago(problem_of(x, row.values(x)), config, states), row.interval, is_right


def _of_table3(task: Task, states: Sequence[bytes] | None = None) -> tuple[Archipelago, int, Judge]:
    """Return the search for an equation of Table III, and what writes down a program that has its form."""
    system, variable = task.problem.split()
    problem = equation_problem(system, variable, task.seed, "near" in task.reading.split("+"))
    data = dict(zip(problem.names, problem.inputs, strict=True))
    deviation = problem.target.standard_deviation

    def is_right(entry: FrontEntry) -> str | None:
        if not entry.error < CLOSE * deviation:
            return None
        text = to_infix(Program.from_bytes(entry.program, len(data)), problem.names)
        return text if compare(text, TRUTH[system][variable], data).is_right else None

    config = config_of(task.reading, task.seed, ("+", "-", "*", "/", "sin", "cos"))
    return Archipelago(problem, config, states), STRIDE, is_right


def equation_problem(system: str, variable: str, seed: int, is_near: bool = False) -> Problem:
    """Return four trajectories of 100 points with the exact derivative of `variable`."""
    states = np.concatenate([values.T for values in _sampled(system, seed, is_near).values], axis=1)
    index = SYSTEMS[system].states.index(variable)
    slopes = np.array([SYSTEMS[system].field(*state)[index] for state in states.T])
    target = Target(variable, f"d{variable}/dt", slopes, 0.0, float(slopes.std()))
    return Problem(SYSTEMS[system].states, np.ascontiguousarray(states), target)


@cache
def _sampled(system: str, seed: int, is_near: bool) -> Sampled:
    if not is_near or system not in NEAR:
        return trajectories(system, STEP, seed)
    its, rng, times = replace(SYSTEMS[system], draw=NEAR[system]), np.random.default_rng(seed), np.arange(100.0) * STEP
    return Sampled(its.states, (times,) * RUNS, tuple(drawn(its, rng, times) for _ in range(RUNS)))


TABLE_III: Final = tuple(f"{system} {variable}" for system, variable in EQUATIONS)
"""The equations, as problems are named."""
