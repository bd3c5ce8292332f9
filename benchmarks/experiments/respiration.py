"""How many further trajectories it takes until the law of bacterial respiration wins, suggested and at random.

``python -m benchmarks.experiments.respiration --seeds 0-9`` begins with the four trajectories of the benchmarks (100
rows, 5 % noise), which 2 y/x describes as well as the true x y/(1 + x^2/2), and adds trajectories of the same length
and noise from initial states that are suggested, or uniform in the same bounds. Structures are fixed and fitted again
after each; the true one has won when its description is shorter by 3 nats than that with y/x in both equations, or when
that cannot be simulated along the data (+inf). Suggested is the first experiment of `suggest`, which has y/x, what it
makes of quotients by itself, and without ``--blind`` the truth as a rival among these.
"""

import math
import sys
from argparse import Namespace
from collections.abc import Mapping, Sequence
from statistics import mean
from typing import Final

import numpy as np
from scipy.integrate import solve_ivp

from atoll.experiments.measured import measured_of
from atoll.experiments.space import Request
from atoll.experiments.suggestions import suggest
from atoll.experiments.systems import equations_of, fit_equations
from atoll_coordinator.model.criteria import constant_nats_of, system_length
from atoll_coordinator.result.result import Result
from benchmarks.experiments.results import Course, FloatArray, result_of
from benchmarks.harness.command_line import option, program, seeds_of
from benchmarks.harness.systems import RUNS, SYSTEMS, solutions

QUOTIENT: Final = {"x": "20 - x - 2*y/x", "y": "10 - 2*y/x"}
TRUTH: Final = {"x": "20 - x - 2*x*y/(2 + x**2)", "y": "10 - 2*x*y/(2 + x**2)"}
NOISE: Final = 0.05
ROWS: Final = 100
MOST: Final = 20
WON: Final = 3.0
Bounds = Mapping[str, tuple[float, float]]
BOUNDS: Final[dict[str, Bounds | None]] = {"data": None, "wide": {"x": (0.1, 15.0), "y": (1.0, 60.0)}}
SYSTEM: Final = SYSTEMS["bacterial_respiration"]


def trajectory(start: Sequence[float], times: FloatArray) -> FloatArray:
    """Return the true states (n, 2) from an initial state."""
    found = solve_ivp(
        lambda _, x: SYSTEM.field(x[0], x[1]), (0.0, times[-1]), start, "LSODA", times, rtol=1e-9, atol=1e-9
    )
    return np.asarray(found.y.T)


def length(found: Result) -> float:
    """Return the description length of the equations of a result, fitted to its data; infinite if they cannot be."""
    measured = measured_of(found)
    fitted = fit_equations(measured, equations_of(found))
    if fitted is None:
        return math.inf
    rows = constant_nats_of(float(measured.rows))
    return system_length(fitted.misfit, fitted.equations.programs, len(fitted.values), rows)


def lead(courses: Sequence[Course], errors: Sequence[float]) -> float:
    """Return by how many nats the truth is the shorter description."""
    lengths = [length(result_of(each, courses, errors)) for each in (QUOTIENT, TRUTH)]
    return lengths[0] - lengths[1] if math.isfinite(lengths[1]) else -math.inf


def needed(seed: int, bounds: Bounds | None, *, is_random: bool, is_blind: bool) -> tuple[int, list[str]]:
    """Return how many further trajectories it took, and each with the lead that it gave."""
    rng = np.random.default_rng([31, seed])
    times = np.arange(ROWS, dtype=np.float64) * 0.1
    clean = solutions(SYSTEM, [times] * RUNS, rng)
    errors = NOISE * np.concatenate(clean).std(axis=0)
    courses: list[Course] = [(times, each + errors * rng.standard_normal(each.shape)) for each in clean]
    ranges = np.concatenate([values for _, values in courses])
    if bounds is None:
        ends = zip(ranges.min(axis=0).tolist(), ranges.max(axis=0).tolist(), strict=True)
        bounds = dict(zip(QUOTIENT, ends, strict=True))
    draws, story = np.random.default_rng([32, seed, int(is_random)]), []
    for count in range(MOST + 1):
        ahead = lead(courses, errors.tolist())
        story.append(f"{ahead:+.1f}")
        if ahead >= WON or count == MOST:
            return count, story
        if is_random:
            start = [float(draws.uniform(*bounds[name])) for name in QUOTIENT]
        else:
            request = Request(bounds, count=1, rivals=() if is_blind else (TRUTH,))
            best = suggest(result_of(QUOTIENT, courses, errors.tolist()), request).experiments[0]
            start = [best.initial[name] for name in QUOTIENT]
        values = trajectory(start, times)
        courses.append((times, values + errors * draws.standard_normal(values.shape)))
        story.append(f"({start[0]:.3g}, {start[1]:.3g})")
    return MOST, story


@program(
    "benchmarks.experiments.respiration",
    __doc__,
    seeds_of("0-9", "such as 0-9, the default"),
    option("--bounds", choices=BOUNDS, default="data", help="range of the data, or wide ones"),
    option("--blind", action="store_true", help="do not give the truth as a rival"),
)
def main(options: Namespace) -> None:
    """Print how many further trajectories each seed needs, and the means."""
    found: dict[str, list[int]] = {"suggested": [], "random": []}
    for seed in options.seeds:
        for how, counts in found.items():
            its = needed(seed, BOUNDS[options.bounds], is_random=how == "random", is_blind=options.blind)
            counts.append(its[0])
            sys.stdout.write(f"seed {seed}, {how}: {its[0]}: {' '.join(its[1])}\n")
            sys.stdout.flush()
    for how, counts in found.items():
        sys.stdout.write(f"{how}: mean {mean(counts):.2f} of {sorted(counts)}\n")


if __name__ == "__main__":
    sys.exit(main())
