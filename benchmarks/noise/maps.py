"""How much noise, how few rows? Maps of noise by length for Lorenz, Rössler and van der Pol: ``benchmarks.noise.maps``.

``python -m benchmarks.noise.maps --draws 10 --out FILE.jsonl`` searches the cells that ODR-BINDy was published with
(arXiv 2507.23426): one trajectory from a fixed initial state, noise of a share of the standard deviation of all values
of the longest one. Default operators, no library and no noise level given; the published runs have both. A file that
exists is gone on with. ``--cells lorenz:0.2:7,8`` chooses a part. Prints in how many draws all equations are exact in
form; returns 1 when a verdict "exact" or "good" is wrong.
"""

import argparse
import sys
from argparse import Namespace
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path as File
from typing import Final

import numpy as np

from atoll.terminal.output import say, table
from atoll_core.data.dataset import FloatArray
from benchmarks.corpus.cases import LEAST_T, fresh_paths, smallest_t
from benchmarks.corpus.systems import CorpusSystem, solution
from benchmarks.harness.campaign import Answer, Service, journal_of, work_off
from benchmarks.harness.command_line import option, positive, program, whole, workers
from benchmarks.harness.jobs import table_of_columns
from benchmarks.harness.tables import grouped
from benchmarks.noise.data import Case, Key
from benchmarks.noise.judging import EquationOutcome, Outcome, search
from benchmarks.noise.tables import by_grade, line, miss

OURS: Final = "atoll"
CONFIDENT: Final = ("exact", "good")
NOISES: Final = tuple(round(0.025 * step, 3) for step in range(1, 17))
STEPS: Final = {"lorenz": 0.01, "roessler": 0.05, "van_der_pol": 0.01}
LENGTHS: Final = {
    "lorenz": tuple(range(4, 11)),
    "roessler": tuple(range(10, 31, 2)),
    "van_der_pol": tuple(range(4, 13)),
}
"""Times at which trajectories end; the first row is one step after 0."""

ASKED: Final = 0.2
"""Noise up to which the longer half of the lengths is summed up."""

SYSTEMS: Final = {
    "lorenz": CorpusSystem(
        "lorenz",
        {"x": "k1*y - k2*x", "y": "k3*x - k4*y - k5*x*z", "z": "k6*x*y - k7*z"},
        {"k1": 10.0, "k2": 10.0, "k3": 28.0, "k4": 1.0, "k5": 1.0, "k6": 1.0, "k7": 8.0 / 3.0},
        ((-15.0, 15.0), (-20.0, 20.0), (5.0, 40.0)), 10.0, ((-8.0, 8.0, 27.0),),
    ),
    "roessler": CorpusSystem(
        "roessler",
        {"x": "-k1*y - k2*z", "y": "k3*x + k4*y", "z": "k5 + k6*x*z - k7*z"},
        {"k1": 1.0, "k2": 1.0, "k3": 1.0, "k4": 0.2, "k5": 0.2, "k6": 1.0, "k7": 5.7},
        ((-8.0, 8.0), (-8.0, 8.0), (0.0, 1.0)), 30.0, ((-6.0, 5.0, 0.0),),
    ),
    "van_der_pol": CorpusSystem(
        "van_der_pol",
        {"x": "k1*y", "y": "k2*y - k3*x**2*y - k4*x"},
        {"k1": 1.0, "k2": 0.5, "k3": 0.5, "k4": 1.0},
        ((-2.0, 2.0), (-2.0, 2.0)), 12.0, ((-2.0, 1.0),),
    ),
}  # fmt: skip
"""Every coefficient is a constant: what the data say of it decides whether they decide its term."""


def cells() -> list[tuple[str, float, float]]:
    """Return system, noise and length of all cells."""
    return [(name, noise, float(length)) for name in SYSTEMS for noise in NOISES for length in LENGTHS[name]]


def chosen(text: str) -> list[tuple[str, float, float]]:
    """Return the cells of ``SYSTEM[:NOISE,…[:LENGTH,…]]``, an empty part for all."""
    names, noises, lengths = [{part for part in one.split(",") if part} for one in (text + "::").split(":")[:3]]
    found = [
        (name, noise, length)
        for name, noise, length in cells()
        if (not names or name in names)
        and (not noises or f"{noise:g}" in noises)
        and (not lengths or f"{length:g}" in lengths)
    ]
    if not found:
        raise argparse.ArgumentTypeError(f"cells such as lorenz:0.2:7,8 were expected, but {text!r} names none")
    return found


def _times(name: str, rows: int) -> FloatArray:
    return STEPS[name] * np.arange(rows, dtype=np.float64)


@lru_cache(maxsize=64)
def _clean(name: str, length: float) -> FloatArray:
    """Return the exact states (n, S), the first of them the initial state."""
    system = SYSTEMS[name]
    return solution(system.field(), system.starts[0], _times(name, round(length / STEPS[name])))


def noise_of(name: str) -> float:
    """Return the deviation of all values of the longest trajectory, which noise is a share of."""
    return float(_clean(name, max(LENGTHS[name])).std(ddof=1))


def case(key: Key) -> Case:
    """Return the table of a draw; the draws of a seed are the same at all noises and lengths, scaled and cut off."""
    system, clean, noisy = SYSTEMS[key.system], _clean(key.system, key.length), _noisy(key)
    times = STEPS[key.system] + _times(key.system, len(clean))
    columns = {"t": times, **dict(zip(system.states, noisy.T, strict=True))}
    exact = dict(zip(system.states, clean.T, strict=True))
    fresh = fresh_paths(system, exact, times, np.random.default_rng([key.seed, 109]))
    return Case(table_of_columns(columns, key.system), system.truths, exact, fresh)


def _noisy(key: Key) -> FloatArray:
    longest = _clean(key.system, max(LENGTHS[key.system]))
    errors = np.random.default_rng([key.seed, 108]).standard_normal(longest.shape)
    clean = _clean(key.system, key.length)
    return np.asarray(clean + key.level * noise_of(key.system) * errors[: len(clean)])


@lru_cache(maxsize=512)
def least_t(name: str, noise: float, length: float) -> float:
    """Return how well the least known coefficient of a cell can be known at best: estimate over standard error."""
    system, key = SYSTEMS[name], Key(OURS, name, noise, 0, length)
    clean = _clean(name, length)
    times = _times(name, len(clean))
    return min(smallest_t(system, system.starts, [times], [clean], [_noisy(key)]).values())


def is_right(outcome: Outcome) -> bool:
    """Tell whether all equations of a draw are exact in form."""
    return all(equation.in_form for equation in outcome.equations)


def is_wrong(equation: EquationOutcome) -> bool:
    """Tell whether a verdict says more than is true: "exact" of another form, "good" of one that does not foretell."""
    if equation.grade not in CONFIDENT or equation.in_form:
        return False
    return equation.grade == "exact" or not equation.is_foretold


def wrong(outcomes: Sequence[Outcome]) -> list[str]:
    """Return a line for each wrong verdict."""
    return [
        f"WRONG {equation.grade}: {outcome.key.title} {equation.variable}: {miss(equation)}"
        for outcome in outcomes
        for equation in outcome.equations
        if is_wrong(equation)
    ]


def map_of(name: str, outcomes: Sequence[Outcome]) -> str:
    """Return a map: rows of noise, columns of length, in how many draws the form is right.

    In brackets where the data do not decide (some coefficient is within five standard errors of zero); ``!`` counts
    wrong verdicts.
    """
    by_cell = grouped(outcomes, lambda outcome: (outcome.key.level, outcome.key.length))
    noises, lengths = ([*dict.fromkeys(sorted(cell[place] for cell in by_cell))] for place in (0, 1))
    rows = [[f"{noise:.1%}", *(_cell(name, noise, length, by_cell) for length in lengths)] for noise in noises]
    return table((name, *(f"T {length:g}" for length in lengths)), rows)


def _cell(name: str, noise: float, length: float, by_cell: "dict[tuple[float, float], list[Outcome]]") -> str:
    draws = by_cell.get((noise, length), [])
    if not draws:
        return "-"
    bad = sum(is_wrong(equation) for outcome in draws for equation in outcome.equations)
    text = f"{sum(map(is_right, draws))}/{len(draws)}" + (f" !{bad}" if bad else "")
    return text if least_t(name, noise, length) >= LEAST_T else f"({text})"


def asked(name: str, outcomes: Sequence[Outcome]) -> str:
    """Return the sum over the longer half of the lengths at noise up to 20 %, cell by cell of what was searched."""
    lengths = sorted(LENGTHS[name])
    longer = lengths[len(lengths) // 2 :]
    counted = [outcome for outcome in outcomes if outcome.key.level <= ASKED and outcome.key.length in longer]
    highest = [outcome for outcome in counted if outcome.key.level == ASKED]
    return f"{name}, T {longer[0]:g} to {longer[-1]:g}: noise up to 20 % {_share(counted)}; at 20 % {_share(highest)}"


def _share(outcomes: Sequence[Outcome]) -> str:
    right = sum(map(is_right, outcomes))
    return f"{right} of {len(outcomes)} ({right / len(outcomes):.0%})" if outcomes else "not searched"


def show(outcomes: Sequence[Outcome]) -> None:
    """Print the maps, the sums and the wrong verdicts."""
    for name, those in grouped(outcomes, lambda outcome: outcome.key.system).items():
        say(map_of(name, those))
        say(asked(name, those) + "\n")
    say(by_grade(outcomes) + "\n")
    say("\n".join([*wrong(outcomes), f'{len(wrong(outcomes))} wrong "exact" or "good"']))


@program(
    "benchmarks.noise.maps",
    __doc__,
    option("--cells", type=chosen, nargs="+", metavar="SYSTEM[:NOISE[:LENGTH]]", help="such as lorenz:0.2:7,8; all"),
    option("--draws", type=whole, default=10, help="draws of noise a cell (%(default)s)"),
    workers(1),
    option("--max-time", type=positive, metavar="SECONDS", help="end of a search; default: none"),
    option("--out", "--resume", type=File, metavar="FILE", help="file of JSON lines, gone on with"),
    option("--only-show", action="store_true", help="search nothing; the maps of what the file holds"),
)
def main(options: Namespace) -> int:
    """Do what the options ask for."""
    among = [cell for part in options.cells for cell in part] if options.cells else cells()
    wanted = [Key(OURS, name, noise, seed, length) for seed in range(options.draws) for name, noise, length in among]
    journal = journal_of("noise.maps", Outcome, options)

    def do(service: Service, key: Key) -> tuple[Outcome, Answer]:
        return search(service(), key, case(key), options.max_time)

    if options.only_show:
        outcomes = [journal.outcomes[key] for key in wanted if key in journal.outcomes]
    else:
        outcomes = work_off(wanted, journal, do, line, options.workers)
    show(outcomes)
    return 1 if wrong(outcomes) else 0


if __name__ == "__main__":
    sys.exit(main())
