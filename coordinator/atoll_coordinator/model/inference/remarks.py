"""Warnings about a pattern of residuals: process noise, differences between trajectories, forcing, hidden states. Pure.

`warn_of_random_walk` decides whether the residuals of a state grow like a random walk. If so, noise is a part of the
law. The mean square of second differences of rows l apart is constant for measurement errors. It grows with l for a
random walk, and with l^4 for a smooth curve (compare variograms, Matheron 1963). Exponents between 1/2 and 5/2 count as
a random walk. A mixture of errors and a smooth curve can also have an exponent in this range, but only over fewer than
three doublings of the lag.

`warn_of_residual_pattern` explains the residuals of rates: derivatives estimated from the data minus the derivatives by
the equation at the smoothed states. It tries, in this order: a constant for each trajectory, a wave in time, a hidden
state.

Doubtful: these are hints and never change a grade. Rates come from smoothed data, so neighbouring residuals are
correlated, and the number of independent rows is a rough estimate.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from atoll_coordinator.data.columns.motion import disagreement, neighbours
from atoll_coordinator.data.recording import Recording, Trajectory
from atoll_coordinator.model.refinement import Refined
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray, IntArray
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import Program

_LAGS: Final = (1, 2, 4, 8)


def warn_of_random_walk(
    recording: Recording, states: Sequence[str] = (), simulated: Sequence[FloatArray] = ()
) -> list[str]:
    """Return a list with a sentence that proposes ``--stochastic``, if residuals grow like a random walk. If not, the
    list is empty.

    `simulated` has the simulated values (O, R) of the `states` along each trajectory that was not held out. Models of a
    stochastic process can rarely be simulated. Without simulations, the measurements are used instead of the residuals.
    """
    walking = []
    for index, state in enumerate(recording.states):
        measured = [part.measured[index] for part in recording.trajectories if not part.held_out]
        residuals = _residuals(measured, state, states, simulated) if simulated else measured
        if _grows_like_walk(measured, residuals, _rounding(recording, index)):
            walking.append(state)
    if not walking:
        return []
    named = ", ".join(f"'{state}'" for state in walking)
    what = "The residuals" if simulated else "The measurements"
    return [
        f"{what} of {named} grow like a random walk. Noise may act on the system itself: with --stochastic, drift "
        "and diffusion are searched for."
    ]


def _residuals(
    measured: Sequence[FloatArray], state: str, states: Sequence[str], simulated: Sequence[FloatArray]
) -> list[FloatArray]:
    """Return measured minus simulated values of a state along each trajectory that was simulated in whole."""
    if state not in states or len(simulated) != len(measured):
        return []
    place = states.index(state)
    return [
        values - course[place]
        for values, course in zip(measured, simulated, strict=True)
        if len(course[place]) == len(values)
    ]


def _rounding(recording: Recording, index: int) -> float:
    """Return the variance of the rounding errors of a state. Rounding errors may have the same value in several
    consecutive rows."""
    quantisation = recording.smoothing[index].quantisation if index < len(recording.smoothing) else None
    return 0.0 if quantisation is None else quantisation.error**2


def _grows_like_walk(measured: Sequence[FloatArray], residuals: Sequence[FloatArray], rounding: float) -> bool:
    """Tell whether residuals grow like a random walk that explains at least 0.1 of the state's variance.

    This is False if the residuals are only as large as rounding errors, whose variance is `rounding`.
    """
    if residuals and float(np.nanvar(np.concatenate(residuals))) <= SETTINGS.inference.excess**2 * rounding:
        return False
    values, rows = np.concatenate(measured), max(map(len, residuals), default=0)
    if rows <= SETTINGS.selection.fewest_steps:
        return False
    squares = [_mean_square(residuals, lag) for lag in _LAGS]
    variance = float(np.nanvar(values))
    if not all(0.0 < square < math.inf for square in squares) or rows * squares[0] < SETTINGS.inference.part * variance:
        return False
    exponents = [math.log2(after / before) for before, after in pairwise(squares)]
    return all(0.5 < exponent < 2.5 for exponent in exponents)


def _mean_square(residuals: Sequence[FloatArray], lag: int) -> float:
    """Return half the mean square of the second differences of rows that are `lag` rows apart. NaN is left out."""
    parts = [
        series[2 * lag :] - 2.0 * series[lag:-lag] + series[: -2 * lag] for series in residuals if len(series) > 2 * lag
    ]
    differences = np.concatenate(parts) / math.sqrt(2.0)
    known = differences[np.isfinite(differences)]
    return float(np.mean(known * known)) if len(known) else math.nan


_FEWEST_RUNS: Final = 3
"""Fewest trajectories that can show a difference between trajectories: with two trajectories, one trajectory may simply
be faulty."""
_HALF: Final = 0.5
"""Share of the variance of the residuals that a pattern must explain."""


@dataclass(frozen=True, eq=False)
class RateResiduals:
    """Residuals (n,) of the rate of one state, with `times` (n,) and the trajectory (`run`) of each row.

    `variables` (V, n) are the values of the variables at these rows, and `rates` (n,) are the derivatives that the
    equation predicts. States were smoothed over `span` rows.
    """

    residuals: FloatArray
    rates: FloatArray
    times: FloatArray
    run: IntArray
    variables: FloatArray
    span: int

    @property
    def rows(self) -> float:
        """Approximate number of independent rows: smoothing correlates the rows within half a span."""
        return max(1.0, 2.0 * len(self.residuals) / max(2, self.span))


def warn_of_residual_pattern(recording: Recording, equations: Mapping[str, Refined], time: str = "t") -> Iterator[str]:
    """For each equation that is not good, yield a warning if a pattern explains most of the residuals."""
    found: dict[str, list[str]] = {}
    period = 0.0
    for place, state in enumerate(recording.states):
        equation = equations.get(state)
        if equation is None or equation.grade in ("exact", "good") or recording.groups:
            continue
        rest = compute_rate_residuals(recording, place, equation.program)
        kind, wave = (None, None) if rest is None else _explain_residuals(rest)
        if kind is not None:
            found.setdefault(kind, []).append(f"'{state}'")
        period = period or wave or 0.0
    runs, forcing, hidden = (" and ".join(found.get(kind, ())) for kind in ("runs", "forcing", "hidden"))
    if runs:
        is_template = any(equation.parameters or equation.unknowns for equation in equations.values())
        option = "add --per-trajectory"
        if is_template or recording.hidden:  # which exclude it
            option = "write --parameter 'c by run' for a parameter c of given equations"
        yield (
            f"Most of the residual of the rate of {runs} is a constant for each trajectory. The trajectories may "
            f"differ in a constant of the law; to allow this, {option}."
        )
    if forcing:
        yield (
            f"Most of the residual of the rate of {forcing} is a wave in time of period {period:.3g} that the states "
            f"do not explain. There may be a forcing; to search for laws that depend on time, add --inputs {time}."
        )
    if hidden:
        advice = "measure another quantity, or add --order 2"
        if recording.order == 2 or recording.hidden:  # hidden states exclude order 2
            advice = "measure another quantity"
        yield (
            f"Equal measured states have different rates of {hidden}, far beyond the noise. A state may be hidden or "
            f"act with a delay; {advice}."
        )


def compute_rate_residuals(recording: Recording, place: int, program: Program) -> RateResiduals | None:
    """Return the residuals of the rate of one state. None if the residuals are about as small as the errors of the
    estimated rates."""
    parts = [part for part in recording.trajectories if not part.held_out and part.rates is not None]
    if not parts or len(recording.smoothing) <= place:
        return None
    variables = np.concatenate([_variables(part, recording.order) for part in parts], axis=1)
    measured = np.concatenate([part.rates[place] for part in parts if part.rates is not None])
    errors = np.concatenate([part.rate_errors[place] for part in parts if part.rate_errors is not None])
    times = np.concatenate([part.times for part in parts])
    run = np.concatenate([np.full(len(part.times), number, np.int64) for number, part in enumerate(parts)])
    with np.errstate(all="ignore"):
        rates = values_of(program, variables) + np.zeros(len(times))
    kept = np.flatnonzero(np.isfinite(errors) & np.isfinite(rates) & np.isfinite(measured))
    if len(kept) < SETTINGS.columns.least_rows:
        return None
    kept = kept[errors[kept] <= SETTINGS.rows.over_median_uncertainty * float(np.median(errors[kept]))]
    residuals = measured[kept] - rates[kept]
    if not float(np.mean(residuals**2)) > 2.0 * float(np.mean(errors[kept] ** 2)):
        return None
    span = recording.smoothing[place].span or SETTINGS.common.fewest_rows
    return RateResiduals(residuals, rates[kept], times[kept], run[kept], variables[:, kept], span)


def _variables(part: Trajectory, order: int) -> FloatArray:
    rows = [part.smoothed, part.slopes, part.inputs] if order == 2 else [part.smoothed, part.inputs]
    return np.concatenate(rows, axis=0)


def _explain_residuals(rest: RateResiduals) -> tuple[str | None, float | None]:
    """Return the pattern that explains most of the residuals, and the period of a forcing."""
    if _differ_by_run(rest):
        return "runs", None
    if not _depends_on_hidden_state(rest):
        return None, None
    period = None if len(rest.variables) == 1 else _find_period(rest)  # one state alone cannot oscillate
    return ("hidden" if period is None else "forcing"), period


def _differ_by_run(rest: RateResiduals) -> bool:
    """Tell whether a summand or a factor for each trajectory explains most of the residuals, and does so significantly
    (F test)."""
    from scipy.special import fdtrc

    runs = int(np.max(rest.run)) + 1
    if runs < _FEWEST_RUNS:
        return False
    for column in (np.ones(len(rest.rates)), rest.rates):
        whole = _residual_squares(rest.residuals, column)
        left = sum(_residual_squares(rest.residuals[rest.run == run], column[rest.run == run]) for run in range(runs))
        free = rest.rows - runs
        if free < 1.0 or not 0.0 <= left < (1.0 - _HALF) * whole:
            continue
        ratio = (whole - left) / (runs - 1) / max(left / free, 1e-300)
        if fdtrc(runs - 1, free, ratio) < SETTINGS.inference.improbable:
            return True
    return False


def _residual_squares(values: FloatArray, column: FloatArray) -> float:
    """Return the sum of squared residuals after fitting a multiple of `column` (n,) to `values` (n,)."""
    square = float(np.sum(column * column))
    factor = float(np.sum(column * values)) / square if square > 0.0 else 0.0
    return float(np.sum((values - factor * column) ** 2))


def _depends_on_hidden_state(rest: RateResiduals) -> bool:
    """Tell whether rows at other times with nearly the same states have different residuals."""
    every = max(1, len(rest.residuals) // SETTINGS.rows.compared)
    coordinates = [np.ascontiguousarray(row[::every]) for row in rest.variables]
    pairs = neighbours(coordinates, rest.run[::every], rest.span // every + 1)
    found = None if pairs is None else disagreement(pairs, rest.residuals[::every])
    return found is not None and found.is_open


def _find_period(rest: RateResiduals) -> float | None:
    """Return the period of a wave in time that explains most of the residuals; None if there is no such wave.

    For each frequency, a wave is fitted by least squares (Lomb 1976). A period has at least four rows, and at least two
    periods fit into the measured time.
    """
    length = float(np.max(rest.times) - np.min(rest.times))
    steps = np.diff(rest.times)
    step = float(np.median(steps[steps > 0.0]))
    residuals = rest.residuals - float(np.mean(rest.residuals))
    whole, best, period = float(np.sum(residuals**2)), math.inf, 0.0
    for frequency in np.arange(2.0, length / (4.0 * step), 0.25).tolist():
        phases = (2.0 * math.pi * frequency / length) * rest.times
        waves = np.stack([np.cos(phases), np.sin(phases)])
        gram, right = waves @ waves.T, waves @ residuals
        determinant = gram[0, 0] * gram[1, 1] - gram[0, 1] ** 2
        if not determinant > 0.0:
            continue
        explained = gram[1, 1] * right[0] ** 2 - 2.0 * gram[0, 1] * right[0] * right[1] + gram[0, 0] * right[1] ** 2
        left = whole - float(explained / determinant)
        if left < best:
            best, period = left, length / frequency
    return period if best < (1.0 - _HALF) * whole else None
