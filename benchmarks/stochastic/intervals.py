"""``python -m benchmarks.stochastic.intervals``: do intervals of constants hold, the equations being the true ones?

The factors of each equation are fitted to paths of 10,000 steps, all of a process at once. With ``--substeps 1`` paths
are tables of Euler and Maruyama's method, and fitted as such.
"""

import sys
from argparse import Namespace
from typing import Final

import numpy as np

from atoll.terminal.output import say, table
from atoll_coordinator.data.increments.steps import Steps
from atoll_coordinator.model.stochastic.conclusion import joint_objections
from atoll_coordinator.model.stochastic.likelihood import ProcessLikelihood, ProcessModel
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.text.parsing import from_infix
from atoll_core.expression.unit_coefficients import make_coefficients_explicit
from benchmarks.harness.command_line import option, program
from benchmarks.stochastic.processes import PROCESSES, SETTLING, STEPS, SUBSTEPS, Process

HEADS: Final = ("process", "paths", "intervals hold", "of", "away", "spread", "drifts doubted", "of")
FAR: Final = {
    "two equations away": Process(
        {"x": "v", "v": "x-x**3-0.5*v", "w": "x-w"}, {"x": "0", "v": "0.25", "w": "0"}, [1.0, 0.0, 0.0]
    )
}
"""A state that follows noise over two equations."""


def _fitted(process: Process, steps: Steps, is_stepped: bool) -> tuple[FloatArray, list[bool]]:
    """Return how many standard errors estimates are away from the truth, and of which states the verdict doubts."""
    names, states = process.names, len(process.names)
    drift = tuple(make_coefficients_explicit(from_infix(text, names)).program for text in process.drift.values())
    diffusion = tuple(from_infix(text, names) for text in process.diffusion.values())
    pairs, noisy = tuple((i, i) for i in range(states)), [text != "0" for text in process.diffusion.values()]
    scheme = "Euler-Maruyama" if is_stepped else "local linearisation"
    model = ProcessModel(drift, diffusion, pairs, (0.0,) * states, scheme)  # type: ignore[arg-type]
    free = (*range(states), *(states + place for place, is_noisy in enumerate(noisy) if is_noisy))
    likelihood = ProcessLikelihood(steps)
    fitted = likelihood.fit(model, free)
    errors = np.sqrt(np.diag(fitted.covariance))
    residuals = likelihood.whitened(fitted.model).residuals
    doubts = [bool(joint_objections(residuals, state, names, has_noise=noisy[state])) for state in range(states)]
    return (fitted.model.parameters(free) - model.parameters(free)) / errors, doubts


def simulate(process: Process, paths: int, seed: int, substeps: int) -> list[Steps]:
    """Return the steps of so many tables of a process, drawn together."""
    random, count = np.random.default_rng(seed), STEPS // process.paths
    settling = SETTLING if process.settles else 0
    rates, squares = process.function(process.drift.values()), process.function(process.diffusion.values())
    is_corrected = "0" in process.diffusion.values() and substeps > 1
    states = np.repeat(np.array(process.starts, dtype=np.float64)[:, None], paths * process.paths, axis=1)
    small, rows = process.step / substeps, [states]
    for _ in range(settling + count):
        for _ in range(substeps):
            drift = np.array([rate + 0.0 * states[0] for rate in rates(*states)])
            spread = np.sqrt(np.array([square + 0.0 * states[0] for square in squares(*states)]) * small)
            moved = states + small * drift + spread * random.standard_normal(states.shape)
            if is_corrected:
                moved += 0.5 * small * (np.array([rate + 0.0 * states[0] for rate in rates(*moved)]) - drift)
            states = moved
        rows.append(states)
    whole = np.array(rows[settling:]).transpose(2, 1, 0)
    return [_steps(whole[first::paths], process.step) for first in range(paths)]


def _steps(paths: FloatArray, step: float) -> Steps:
    moved = np.concatenate([*np.diff(paths, axis=2)], axis=1)
    follows = np.tile(np.arange(paths.shape[2] - 1) > 0, len(paths))
    points = np.ascontiguousarray(np.concatenate([*paths[:, :, :-1]], axis=1))
    return Steps(points, np.full(moved.shape[1], step), np.ascontiguousarray(moved), follows)


CASES: Final = {name: process for name, process in {**PROCESSES, **FAR}.items() if not process.noise}


@program(
    "benchmarks.stochastic.intervals",
    __doc__,
    option("--processes", nargs="*", choices=[*CASES], default=[*CASES], metavar="NAME"),
    option("--paths", type=int, default=100, help="of each process (%(default)s)"),
    option("--substeps", type=int, default=SUBSTEPS, help="of each step (%(default)s)"),
    option("--seed", type=int, default=0, help="of all paths (%(default)s)"),
    description=__doc__,
)
def main(options: Namespace) -> None:
    """Run what the command line asks for."""
    rows = []
    for name in options.processes:
        fits = [_fitted(CASES[name], steps, options.substeps == 1)
                for steps in simulate(CASES[name], options.paths, options.seed, options.substeps)]  # fmt: skip
        away = np.concatenate([errors for errors, _ in fits])
        doubts = [doubt for _, doubts_of_fit in fits for doubt in doubts_of_fit]
        holds = np.abs(away) < 1.96
        numbers = (len(fits), holds.sum(), len(away), f"{away.mean():.2f}", f"{np.sqrt(np.mean(away**2)):.2f}")
        rows.append((name, *map(str, numbers), str(sum(doubts)), str(len(doubts))))
        say(table(HEADS, rows[-1:]))
    say(table(HEADS, rows))


if __name__ == "__main__":
    sys.exit(main())
