"""How often intervals by profile likelihood, and by the standard error, hold the true constant.

``python -m benchmarks.experiments.coverage --seeds 0-199`` simulates the measurements of each case with fresh errors
for each seed and fits the true structure; no search. Intervals are of 95 %.
"""

from argparse import Namespace
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.integrate import solve_ivp

from atoll.experiments.identifiability import identify
from atoll.terminal.output import say
from atoll_coordinator.result.result import Result
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import AtollError
from atoll_core.expression.text.parsing import from_infix
from benchmarks.harness.command_line import option, program, seeds_of
from benchmarks.harness.tables import markdown

Course = tuple[FloatArray, FloatArray]
"""Times (n,) and measured states (n, D)."""


@dataclass(frozen=True)
class Case:
    """A system with `rates`, the `equations` to fit, true `constants` in the order of the text, and how it is measured.

    `noise` is over the standard deviation of each state, pooled over trajectories.
    """

    rates: Callable[[FloatArray], list[float]]
    equations: dict[str, str]
    constants: tuple[float, ...]
    starts: tuple[tuple[float, ...], ...]
    duration: float
    rows: int
    noise: float


def _saturation(x: FloatArray) -> list[float]:
    return [-2.0 * x[0] / (3.0 + x[0])]


def _logistic(x: FloatArray) -> list[float]:
    return [0.8 * x[0] - 0.08 * x[0] ** 2]


def _predation(x: FloatArray) -> list[float]:
    eaten = x[0] * x[1] / (1.0 + x[0])
    return [x[0] * (1.0 - 0.2 * x[0]) - eaten, 0.8 * eaten - 0.4 * x[1]]


def _lotka_volterra(x: FloatArray) -> list[float]:
    return [0.5 * x[0] - 0.3 * x[0] * x[1], 0.2 * x[0] * x[1] - 0.6 * x[1]]


SATURATION: Final = {"x": "-2*x/(3 + x)"}, (-2.0, 3.0)
LOGISTIC: Final = {"x": "0.8*x - 0.08*x**2"}, (0.8, 0.08)
PREDATION: Final = {"x": "1*x - 0.2*x**2 - x*y/(1.0001 + x)", "y": "0.8*x*y/(1.0001 + x) - 0.4*y"}
HEADS: Final = ("case", "constant", "truth", "profile", "standard error", "it lies below, above", "open")
CASES: Final = {
    "saturation, both sides of the knee, 5 %": Case(_saturation, *SATURATION, ((12.0,), (2.0,)), 8.0, 20, 0.05),
    "saturation, at the knee, 20 %": Case(_saturation, *SATURATION, ((3.0,), (1.5,)), 4.0, 20, 0.2),
    "saturation, below the knee, 8 %": Case(_saturation, *SATURATION, ((1.5,), (1.0,)), 4.0, 20, 0.08),
    "saturation, far below the knee, 10 %": Case(_saturation, *SATURATION, ((0.8,),), 4.0, 8, 0.1),
    "logistic growth, up to the bend, 20 %": Case(_logistic, *LOGISTIC, ((0.4,),), 5.0, 10, 0.2),
    "decay to a rest, 7 rows, 20 %": Case(
        lambda x: [1.0 - 0.4 * x[0]], {"x": "1 - 0.4*x"}, (1.0, 0.4), ((0.2,),), 5.0, 7, 0.2
    ),
    "saturating predation, 15 %": Case(
        _predation, PREDATION, (1.0, 0.2, 1.0, 0.8, 1.0, 0.4), ((0.8, 0.6),), 12.0, 25, 0.15
    ),
    "Lotka-Volterra, 5 %": Case(
        _lotka_volterra, {"x": "0.5*x - 0.3*x*y", "y": "0.2*x*y - 0.6*y"}, (0.5, 0.3, 0.2, 0.6),
        ((4.0, 1.0), (2.0, 2.0)), 12.0, 30, 0.05,
    ),
}  # fmt: skip


@dataclass
class Count:
    """Of one constant: intervals that hold the truth by profile and by standard error, open ones, and all."""

    profile: int = 0
    quadratic: int = 0
    below: int = 0
    above: int = 0
    opened: int = 0
    seeds: int = 0


def courses(case: Case, rng: np.random.Generator) -> tuple[list[Course], FloatArray]:
    """Return noisy trajectories, and the standard deviation of the errors of each state."""
    times = np.linspace(0.0, case.duration, case.rows)
    clean = [
        solve_ivp(lambda _, x: case.rates(x), (0.0, case.duration), start, "DOP853", times, rtol=1e-10, atol=1e-12).y.T
        for start in case.starts
    ]
    errors = case.noise * np.concatenate(clean).std(axis=0)
    return [(times, states + errors * rng.standard_normal(states.shape)) for states in clean], errors


def result_of(
    equations: Mapping[str, str],
    courses: Sequence[Course],
    errors: Sequence[float],
    starts: Sequence[Sequence[float]] = (),
) -> Result:
    """Return a result, as of a job, that shows these equations, measured with errors of known size.

    `starts` are initial states that fits begin with; the measured ones unless given.
    """
    states = [*equations]
    begun = [
        {"name": str(number), "start": dict(zip(states, map(float, start), strict=True))}
        for number, start in enumerate(starts, start=1)
    ]
    content = {
        "schema": 1,
        "equations": [_equation(name, text, states) for name, text in equations.items()],
        "symbols": {name: name for name in states},
        "system": {"kind": "dynamics", "order": 1, "time": "t", "states": states, "velocities": [], "inputs": []},
        "simulation": {"trajectories": begun},
        "noise": {
            name: {"sd": error, "relative": error, "method": "loess"}
            for name, error in zip(states, errors, strict=True)
        },
        "data": {
            "trajectories": [_trajectory(number, *course, states) for number, course in enumerate(courses, start=1)]
        },
    }
    return Result.of(content)


def _equation(name: str, text: str, states: Sequence[str]) -> dict[str, Any]:
    program = from_infix(text, states).to_bytes().hex()
    return {"variable": name, "lhs": f"d{name}/dt", "expression": text, "program": program, "candidates": []}


def _trajectory(number: int, times: FloatArray, values: FloatArray, states: Sequence[str]) -> dict[str, Any]:
    return {
        "name": str(number),
        "held_out": False,
        "rows": len(times),
        "times": times.tolist(),
        "measured": {name: column.tolist() for name, column in zip(states, values.T, strict=True)},
        "inputs": {},
        "input_slopes": {},
        "weights": None,
        "robustness_weights": None,
    }


def count(case: Case, numbers: Sequence[int]) -> tuple[dict[str, Count], int]:
    """Return what the intervals of each constant hold, and how many fits failed."""
    counted = {f"c{number}": Count() for number in range(1, len(case.constants) + 1)}
    failed = 0
    for seed in numbers:
        measured, errors = courses(case, np.random.default_rng([17, seed]))
        try:
            known = identify(result_of(case.equations, measured, errors.tolist(), case.starts))
        except AtollError:
            failed += 1
            continue
        for (name, counts), truth in zip(counted.items(), case.constants, strict=True):
            constant = known[name]
            counts.seeds += 1
            counts.profile += constant.interval[0] <= truth <= constant.interval[1]
            counts.quadratic += constant.quadratic[0] <= truth <= constant.quadratic[1]
            counts.below += truth < constant.quadratic[0]
            counts.above += truth > constant.quadratic[1]
            counts.opened += constant.verdict != "determined"
    return counted, failed


def rows(numbers: Sequence[int], names: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """Yield a row of the table for each constant of each case."""
    for name in names:
        case = CASES[name]
        counts, failed = count(case, numbers)
        label = f"{name} ({failed} not fitted)" if failed else name
        for (constant, held), truth in zip(counts.items(), case.constants, strict=True):
            shares = [f"{100.0 * number / max(held.seeds, 1):.1f} %" for number in (held.profile, held.quadratic)]
            sides = f"{held.below}, {held.above}"
            yield label, constant, f"{truth:g}", *shares, sides, f"{held.opened} of {held.seeds}"


@program(
    "benchmarks.experiments.coverage",
    __doc__,
    seeds_of("0-199", "such as 0-9 (0-199)"),
    option("--case", action="append", choices=CASES),
)
def main(options: Namespace) -> None:
    """Print the table."""
    say(markdown(HEADS, rows(options.seeds, options.case or [*CASES])))


if __name__ == "__main__":
    main()
