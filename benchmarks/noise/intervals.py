"""Do 95 % intervals of constants hold the truth, and which errors are taken for others? ``benchmarks.noise.intervals``.

``python -m benchmarks.noise.intervals --tables 150`` draws one trajectory of three laws (decay, cooling, logistic
growth) with independent errors, errors of a share of the value, and errors of which neighbours have a correlation of
0.6, fits the constants of the law as it is, without a search, and counts the intervals that hold the truth. Prints a
table; returns 1 where fewer than nine of ten hold anywhere.
"""

import sys
from argparse import Namespace
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll.terminal.output import say, table
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.constants.standard_errors import student_quantile_95
from atoll_coordinator.model.inference.final_model import estimate_errors
from atoll_coordinator.model.selection.candidates import CandidateSet
from atoll_coordinator.model.selection.task import ModellingTask
from atoll_core.config import JobConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.text.parsing import from_infix
from benchmarks.harness.command_line import option, positive, program, whole
from benchmarks.harness.jobs import table_of_columns


@dataclass(frozen=True)
class Law:
    """The text of a law of x, its solution, and how long it is measured."""

    text: str
    solution: Callable[[FloatArray], FloatArray]
    duration: float


LAWS: Final = {
    "decay": Law("-0.4*x", lambda t: 5.0 * np.exp(-0.4 * t), 6.0),
    "cooling": Law("0.5*20.0 - 0.5*x", lambda t: 20.0 + 60.0 * np.exp(-0.5 * t), 7.0),
    "logistic": Law("0.8*x - 0.08*x*x", lambda t: 10.0 / (1.0 + 9.0 * np.exp(-0.8 * t)), 10.0),
}
ERRORS: Final = ("independent", "proportional", "ar1")
CORRELATION: Final = 0.6


@dataclass(frozen=True)
class Fit:
    """Of one table: which constants have an interval that holds the truth, and what errors were taken to be."""

    holds: tuple[bool, ...]
    are_growing: bool
    are_correlated: bool


def drawn(law: Law, rows: int, errors: str, level: float, seed: int) -> dict[str, FloatArray]:
    """Return the columns of one table; `level` is the size of the errors over the deviation of x."""
    rng = np.random.default_rng([seed, rows, ERRORS.index(errors)])
    times = np.linspace(0.0, law.duration, rows)
    states, unit = law.solution(times), rng.normal(size=rows)
    if errors == "proportional":
        unit *= states / np.sqrt(np.mean(states**2))
    elif errors == "ar1":
        for row in range(1, rows):
            unit[row] = CORRELATION * unit[row - 1] + np.sqrt(1.0 - CORRELATION**2) * unit[row]
    return {"t": times, "x": states + level * states.std() * unit}


def fit(law: Law, columns: dict[str, FloatArray]) -> Fit | None:
    """Return what the fit of the law itself says of its constants; None where it fails."""
    config = JobConfig()
    prepared = prepare(table_of_columns(columns, "drawn"), config)
    assert prepared.recording is not None, "states are measured"
    task = ModellingTask(prepared.dataset, prepared.recording, config, {"x": CandidateSet()})
    written = from_infix(law.text, ("x",))
    comparison = task.comparison
    model = comparison.fit_model([written])
    if model is None:
        return None
    comparison, model = comparison.calibrate(model)
    errors = estimate_errors(comparison, model)
    truth = written.constants[written.constants != 0.0]
    reach = student_quantile_95(errors.degrees_of_freedom) * np.sqrt(np.diag(errors.covariance))
    weights = comparison.estimator.measurements.inverse_variances
    holds = tuple((np.abs(errors.values - truth) <= reach).tolist())
    return Fit(holds, weights is not None and float(np.ptp(weights)) > 0.0, comparison.score.errors is not None)


@program(
    "benchmarks.noise.intervals",
    __doc__,
    option("--tables", type=whole, default=50, help="of each law, kind of errors and number of rows (%(default)d)"),
    option("--rows", type=whole, nargs="+", default=[8, 12, 20, 60], help="rows of a table (8 12 20 60)"),
    option("--errors", nargs="+", choices=ERRORS, default=list(ERRORS), help="kinds of errors; default: all"),
    option("--noise", type=positive, default=0.03, help="size of the errors over the deviation (%(default)g)"),
    option("--seed", type=whole, default=1, help="the first seed (%(default)d)"),
)
def main(options: Namespace) -> int:
    """Do what the options ask for."""
    lines, least = [], 1.0
    for errors in options.errors:
        for rows in options.rows:
            seeds = range(options.seed, options.seed + options.tables)
            made = [fit(law, drawn(law, rows, errors, options.noise, seed)) for law in LAWS.values() for seed in seeds]
            fits = [one for one in made if one is not None]
            holds = [hold for one in fits for hold in one.holds]
            least = min(least, float(np.mean(holds)))
            growing, correlated = sum(one.are_growing for one in fits), sum(one.are_correlated for one in fits)
            shares = (float(np.mean(holds)), growing / len(fits), correlated / len(fits))
            held, *taken = shares
            lines.append([errors, str(rows), str(len(fits)), f"{held:.1%}", *(f"{share:.0%}" for share in taken)])
    say(table(["errors", "rows", "fits", "intervals hold", "taken to grow", "taken to be correlated"], lines))
    return int(least < 0.9)


if __name__ == "__main__":
    sys.exit(main())
