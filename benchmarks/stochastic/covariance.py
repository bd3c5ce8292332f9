"""``python -m benchmarks.stochastic.covariance``: how often a covariance of two noises is sought, with and without one.

Paths of 10,000 steps, in small steps of Euler and Maruyama, all of a case at once; `correlation` is that of the noises
of the first two states, which are the last to have none in the cases that begin the table.
"""

import sys
from argparse import Namespace
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll.terminal.output import say, table
from atoll_coordinator.data.increments.bins import split_into_bins
from atoll_coordinator.data.increments.correlations import correlated_pairs
from atoll_coordinator.data.increments.moments import bin_count
from atoll_coordinator.data.increments.steps import Steps
from atoll_core.data.dataset import FloatArray
from benchmarks.harness.command_line import option, program
from benchmarks.stochastic.processes import PROCESSES, SETTLING, STEPS, Process

SMALL: Final = 10
"""Small steps in each step."""
LONGEST: Final = 1.7
"""Steps that are uneven are from 0.3 to 1.7 times as long as even ones."""


@dataclass(frozen=True)
class Case:
    """A process whose first two states have noises of this `correlation`; errors of measurement; uneven steps."""

    process: Process
    correlation: float = 0.0
    noise: float = 0.0
    is_uneven: bool = False


_TURNING: Final = PROCESSES["van der Pol"]
_TWO: Final = Process({"x": "-x", "y": "-y"}, {"x": "0.25", "y": "0.25"}, [0.0, 0.0])
CASES: Final = {
    "Ornstein-Uhlenbeck, two states": Case(_TWO),
    "the same, errors of 0.1": Case(_TWO, noise=0.1),
    "van der Pol": Case(_TURNING),
    "van der Pol, uneven steps": Case(_TURNING, is_uneven=True),
    "van der Pol, errors of 0.05": Case(_TURNING, noise=0.05),
    "Lotka-Volterra": Case(PROCESSES["Lotka-Volterra"]),
    "Lorenz": Case(PROCESSES["Lorenz"]),
    **{f"van der Pol, correlation {value}": Case(_TURNING, value) for value in (0.05, 0.1, 0.2)},
    **{f"Lorenz, correlation {value}": Case(PROCESSES["Lorenz"], value) for value in (0.05, 0.1, 0.2)},
}


def _pairs(steps: Steps) -> list[tuple[int, int]]:
    return correlated_pairs(steps, split_into_bins(steps.points, bin_count(steps)))


def simulate(case: Case, paths: int, steps: int, seed: int) -> list[Steps]:
    """Return so many paths of a case, as one trajectory each."""
    random, process = np.random.default_rng(seed), case.process
    size, count = len(process.names), steps + SETTLING
    lengths = np.full(count, process.step)
    if case.is_uneven:
        lengths *= random.uniform(2.0 - LONGEST, LONGEST, count)
    joint = np.eye(size)
    joint[0, 1] = joint[1, 0] = case.correlation
    factor = np.linalg.cholesky(joint)
    rates, squares = process.function(process.drift.values()), process.function(process.diffusion.values())
    states, rows = np.repeat(np.array(process.starts)[:, None], paths, axis=1), []
    for length in (lengths / SMALL).tolist():
        for _ in range(SMALL):
            normal = factor @ random.standard_normal((size, paths))
            spread = np.array([np.sqrt(square) * np.ones(paths) for square in squares(*states)])
            states = states + length * np.array(rates(*states)) + spread * np.sqrt(length) * normal
        rows.append(states)
    sampled = np.array(rows[SETTLING - 1 :])
    sampled = (sampled + case.noise * random.standard_normal(sampled.shape)).transpose(2, 1, 0)
    return [_steps(path, lengths[SETTLING:]) for path in sampled]


def _steps(path: FloatArray, lengths: FloatArray) -> Steps:
    moved = np.ascontiguousarray(np.diff(path, axis=1))
    return Steps(np.ascontiguousarray(path[:, :-1]), lengths, moved, np.arange(len(lengths)) > 0)


@program(
    "benchmarks.stochastic.covariance",
    __doc__,
    option("--paths", type=int, default=100, help="of each case (%(default)s)"),
    option("--steps", type=int, default=STEPS, help="of each path (%(default)s)"),
    option("--seed", type=int, default=0, help="of all paths (%(default)s)"),
    description=__doc__,
)
def main(options: Namespace) -> None:
    """Run what the command line asks for."""
    rows = []
    for name, case in CASES.items():
        sought = [_pairs(steps) for steps in simulate(case, options.paths, options.steps, options.seed)]
        first, others = sum((0, 1) in pairs for pairs in sought), sum(bool({*pairs} - {(0, 1)}) for pairs in sought)
        rows.append((name, str(options.paths), f"{100.0 * first / options.paths:.0f} %", f"{others}"))
    say(table(("process", "paths", "first pair sought", "others"), rows))


if __name__ == "__main__":
    sys.exit(main())
