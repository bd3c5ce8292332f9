"""Fits of given forms with hidden states from many starts: which share of the starts reaches the best minimum.

``python -m benchmarks.operations.many_starts glycolysis --rows 60 --noise 0.05`` draws start values of all parameters
within their bounds. It fits each start in three ways: to whole trajectories with linear steps, to whole trajectories
with steps in logarithms, and to growing horizons with the prior of the bounds. It prints how many starts of each way
reach the best minimum (within 2 nats), and the processor time of all starts. The last line is `fit_from_many_starts`:
the number of starts, how often the best minimum was reached, and the largest relative error of a parameter. ``--noise``
is a share of each column's mean (glycolysis) or of its standard deviation. Glycolysis is the system of Philipps et al.
2025, t <= 1.5, with all 12 parameters and the unknown rest k A3 free, and given initial values.
"""

import math
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.integrate import solve_ivp

from atoll.terminal.output import say, table
from atoll_coordinator.model.shooting.many_starts import StartPoint, StartsProblem, fit_from_many_starts
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.model.shooting.points_between import latin_hypercube
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.text.parsing import from_infix
from benchmarks.harness.command_line import option, program, whole
from tests.unit.coordinator.model.shooting.given import Bounds, for_states, given_system, measured_columns, ranges

_RATE: Final = "k1*S1*A3/(1 + (A3/K1)**4)"


@dataclass(frozen=True)
class GivenForm:
    """A system with known `values` of its parameters, their bounds, the `start` of all states with its bounds, the
    indices of the measured states, and the time of the last row."""

    sides: Mapping[str, str]
    values: Mapping[str, float]
    bounds: Mapping[str, Bounds]
    start: tuple[float, ...]
    start_bounds: tuple[Bounds, ...]
    measured: tuple[int, ...]
    end: float
    is_of_mean: bool = False

    def solve(self, times: FloatArray) -> FloatArray:
        """Return the states (D, N)."""
        names, numbers = (*self.sides, *self.values), list(self.values.values())
        programs = [from_infix(text, names) for text in self.sides.values()]

        def rates(_: float, states: FloatArray) -> list[float]:
            point = np.array([*states, *numbers])[:, None]
            return [float(values_of(program, point)[0]) for program in programs]

        span = (float(times[0]), float(times[-1]))
        return np.asarray(solve_ivp(rates, span, self.start, "LSODA", times, rtol=1e-10, atol=1e-12).y)


FORMS: Final = {
    "glycolysis": GivenForm(
        {
            "S1": f"J0 - {_RATE}",
            "S2": f"2*{_RATE} - k2*S2*(N - N2) - k6*S2*N2",
            "S3": "k2*S2*(N - N2) - k3*S3*(A - A3)",
            "S4": "k3*S3*(A - A3) - k4*S4*N2 - kappa*(S4 - X)",
            "N2": "k2*S2*(N - N2) - k4*S4*N2 - k6*S2*N2",
            "A3": f"2*k3*S3*(A - A3) - 2*{_RATE} - k*A3",
            "X": "phi*kappa*(S4 - X) - kex*X",
        },
        {"J0": 2.5, "k1": 100.0, "k2": 6.0, "k3": 16.0, "k4": 100.0, "k6": 12.0, "kex": 1.8, "kappa": 13.0,
         "K1": 0.52, "N": 1.0, "A": 4.0, "phi": 0.1, "k": 1.28},
        {"k1": (1.0, 1000.0), "k4": (1.0, 1000.0), "K1": (0.01, 10.0), "phi": (0.01, 10.0)}
        | dict.fromkeys(("J0", "k2", "k3", "k6", "kex", "kappa", "N", "A", "k"), (0.1, 100.0)),
        (1.187, 0.193, 0.05, 0.115, 0.077, 2.475, 0.077),
        tuple((value, value) for value in (1.187, 0.193, 0.05, 0.115, 0.077, 2.475, 0.077)),
        (4, 5), 1.5, is_of_mean=True,
    ),
    "nerve": GivenForm(
        {"v": "v - v**3/3 - w + 0.5", "w": "(v + a - b*w)/tau"},
        {"a": 0.7, "b": 0.8, "tau": 12.5},
        {"a": (0.07, 7.0), "b": (0.08, 8.0), "tau": (1.0, 100.0)},
        (-1.0, 0.5), ((-np.inf, np.inf), (-2.0, 2.0)), (0,), 100.0,
    ),
    "lorenz": GivenForm(
        {"x": "s*(y - x)", "y": "x*(r - z) - y", "z": "x*y - b*z"},
        {"s": 10.0, "r": 28.0, "b": 8.0 / 3.0},
        {"s": (1.0, 100.0), "r": (1.0, 100.0), "b": (0.1, 10.0)},
        (-8.0, 7.0, 27.0), ((-np.inf, np.inf), (-50.0, 50.0), (0.0, 60.0)), (0,), 10.0,
    ),
}  # fmt: skip


def problem_of(form: GivenForm, rows: int, noise: float, seed: int) -> tuple[StartsProblem, list[str]]:
    """Return the fits of a form to noisy rows, and the names of the fitted numbers."""
    times = np.linspace(0.0, form.end, rows)
    exact = form.solve(times)[list(form.measured)]
    sizes = noise * (exact.mean(axis=1) if form.is_of_mean else exact.std(axis=1))
    values = exact + sizes[:, None] * np.random.default_rng(seed).standard_normal(exact.shape)
    names = tuple(form.sides)
    columns = measured_columns(values, times, [names[place] for place in form.measured], np.maximum(sizes, 1e-8))
    measurements = for_states(columns, names, form.measured, ranges(times, *form.start_bounds))
    system, numbers = given_system(form.sides, names, form.bounds)
    return StartsProblem(measurements, 1e-6 if noise else 1e-8, 60, system, None), numbers


def drawn_starts(problem: StartsProblem, count: int) -> list[StartPoint]:
    """Return starts within the bounds."""
    system, measurements = problem.system, problem.measurements
    assert system.lower is not None
    assert system.upper is not None
    bounds = measurements.start_ranges(measurements.bounds)
    assert bounds is not None
    starts = []
    for shares in latin_hypercube(count, system.count + len(measurements.scales), 1):
        values = system.lower * (system.upper / system.lower) ** shares[: system.count]
        lower, upper = (np.where(np.isfinite(bound), bound, measurements.smoothed[:, 0]) for bound in bounds)
        starts.append(StartPoint(values, lower + shares[system.count :] * (upper - lower)))
    return starts


def misfits(problem: StartsProblem, starts: list[StartPoint], *, horizons: bool) -> list[float]:
    """Return n/2 ln s of the fits of all starts; infinity for fits that fail."""
    counts, found = problem.measurements.rows, []
    for start in starts:
        reached, _ = problem.fit(replace(start, is_last=not horizons))
        if reached is not None and horizons:
            reached, _ = problem.fit(StartPoint(reached.values, reached.starts, is_last=True))
        found.append(math.inf if reached is None else 0.5 * counts * float(np.log(reached.squares + 1e-18).sum()))
    return found


def timed(function: Callable[[], list[float]]) -> tuple[list[float], float]:
    """Return the values of a function and its processor seconds."""
    before = time.process_time()
    return function(), time.process_time() - before


@program(
    "benchmarks.operations.many_starts",
    __doc__,
    option("form", choices=list(FORMS)),
    option("--rows", type=whole, default=60),
    option("--noise", type=float, default=0.0, metavar="SHARE"),
    option("--starts", type=whole, default=64),
    option("--seed", type=int, default=0),
)
def main(options: Namespace) -> None:
    """Fit all starts in three ways, and print a line for each way."""
    form = FORMS[options.form]
    problem, numbers = problem_of(form, options.rows, options.noise, options.seed)
    linear = replace(problem, system=replace(problem.system, is_logarithmic=None))
    starts = drawn_starts(problem, options.starts)
    ways = {
        "whole trajectories, linear steps": timed(lambda: misfits(linear, starts, horizons=False)),
        "whole trajectories, in logarithms": timed(lambda: misfits(problem, starts, horizons=False)),
        "growing horizons, in logarithms": timed(lambda: misfits(problem, starts, horizons=True)),
    }
    best = min(min(found) for found, _ in ways.values())
    lines = [
        (way, f"{sum(misfit < best + 2.0 for misfit in found)} of {len(found)}", f"{seconds:.1f}")
        for way, (found, seconds) in ways.items()
    ]
    estimator = MultipleShooting(problem.measurements, problem.tolerance, measured_rows=problem.measured_rows)
    before = time.process_time()
    result = fit_from_many_starts(estimator, problem.system, options.seed)
    seconds = time.process_time() - before
    if result is not None:
        values = zip(numbers, result.fit.system.values.tolist(), strict=True)
        error = max(abs(value / form.values[name] - 1.0) for name, value in values)
        reached = f"{result.minima[0].reached} of {result.starts}, error {100.0 * error:.2g} %"
        lines.append(("fit_from_many_starts", reached, f"{seconds:.1f}"))
    say(table((options.form, "best minimum", "cpu s"), lines))


if __name__ == "__main__":
    sys.exit(main())
