"""Forecasts: the states after the last row, with bands, and the horizon within which they are informative.

How it works. The state at the last row is fitted to the last rows of the trajectory, the window, with the constants of
the result (ADR 0109). Windows are doubled as long as one simulation describes both halves (`states`): errors that grow
(chaos), and effects that the law misses, end them. Of these windows, the longest one is taken from which the last state
is known well. Then draws are simulated. Each draw has constants (`draws`) and a state at the last row that belongs to
these constants. If other systems describe the measurements of the result about as well, each of them gets its share of
the draws: its Akaike weight (`alternatives`). Quantiles of the draws are the bands.

The horizon. Without a forecast, the best guess of a state is the range that holds 95 % of its measured values. A
forecast is worth one bit if its 95 % band is half as wide as this range. The horizon of a state ends where the band
becomes wider. The range also contains the median of the forecast up to that time: a state that grows beyond all
measured values needs no narrower band than before.

Doubtful: a window that is shorter than the fit of the constants shares its rows with them, so that the band at the last
row may be too narrow, by a fifth for a straight line. For given constants, the drawn states at the last row are normal,
and they follow the constants to first order. The bands assume that one of the drawn systems is right, and contain no
measurement errors. For a stochastic process, the last row counts as exact, and so do the constants.

Letters: D states, U inputs, K offsets, P constants, N times, M draws, R rows.
"""

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from atoll.experiments.alternatives import WeightedSystem, alternatives_of
from atoll.experiments.draws import draw_constants
from atoll.experiments.fits import eigenaxes
from atoll.experiments.states import KnownLaw, StateFit, cut, rounded_times
from atoll.model.arguments import GivenInputs, InputFunctions, inputs_along
from atoll.model.core import ModelCore, config_of
from atoll.model.simulation import MOST_NUMBERS, Inputs, ensemble_of
from atoll.terminal.output import plain
from atoll_coordinator.data.differentiation.inputs import InputCurve, estimate_input_slopes
from atoll_coordinator.data.recording import InputKind
from atoll_coordinator.model.shooting.integration import STEPS_PER_ROW
from atoll_coordinator.model.shooting.kernels.implicit import STIFF
from atoll_coordinator.model.shooting.kernels.integrate import PRECISE, integrate_segments
from atoll_coordinator.model.shooting.measurements import TrajectoryMeasurements
from atoll_coordinator.result.result import Result
from atoll_core.data.dataset import FloatArray
from atoll_core.data.frames import FrameLibrary, csv_of, frame_of
from atoll_core.data.table import Table
from atoll_core.errors import AtollError, UsageError
from atoll_core.expression.evaluation import values_of
from atoll_core.quoting import did_you_mean, first_lines

if TYPE_CHECKING:
    import polars

SCHEMA: Final = 1
ROWS: Final = 201
"""Number of times of a forecast if no time step is given."""
DRAWS: Final = 1_000
"""Number of draws: the share of draws below the lower end of a 95 % band is known to 0.5 %."""
_SHARES: Final = (0.025, 0.25, 0.5, 0.75, 0.975)
"""Shares of the draws below the ends of the 95 % band, the 50 % band, and the median."""
_BANDS: Final = {0.95: (0, 4), 0.5: (1, 3)}
"""The ends of each band among these shares."""
_ROWS_PER_NUMBER: Final = 2
"""Measured values of the first window for each fitted number."""
_FEWEST_ROWS: Final = 5
_BIT: Final = 0.5
"""Width of a band, in widths of the measured range, of a forecast that is worth one bit."""
_LARGEST: Final = 1e150
_MOST_ROWS: Final = 1e12
"""Largest duration in measured time steps that counts for the number of integration steps, which is an integer."""


@dataclass(frozen=True)
class ForecastRequest:
    """A request for a forecast.

    `duration` is its length after the last row. `trajectory` names the trajectory; None: the last one. `step` is the
    time step; None: `ROWS` times. `draws` is the number of draws, `seed` their random seed. `has_rivals`: alternative
    systems are drawn too.
    """

    duration: float
    trajectory: str | None = None
    step: float | None = None
    draws: int = DRAWS
    seed: int = 0
    has_rivals: bool = True

    def times(self, last: float) -> FloatArray:
        """Return the times (N,), the first of which is the time of the last row."""
        step = self.duration / (ROWS - 1) if self.step is None else self.step
        count = math.floor(self.duration / step + 1e-9) + 1
        return rounded_times(np.array([last + step * number for number in range(count)]))

    def check(self, states: int) -> None:
        """Raise UsageError if a number is out of range."""
        for what, value in (("duration of a forecast", self.duration), ("time step", self.step)):
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise UsageError(f"the {what} must be above 0, but {value!r} was given")
        if self.draws < 2 or self.seed < 0:
            raise UsageError(
                f"a forecast needs 2 or more draws and a seed of 0 or more, but {self.draws} and {self.seed} were given"
            )
        rows = ROWS if self.step is None else self.duration / self.step
        if self.step is not None and self.step > self.duration:
            raise UsageError(f"the time step {self.step:g} is longer than the forecast, {self.duration:g}")
        if rows * self.draws * states > MOST_NUMBERS:
            raise UsageError(
                f"{rows:.0f} times and {self.draws} draws of {states} states are more than {MOST_NUMBERS} numbers; "
                "give a larger time step or fewer draws"
            )


@dataclass(frozen=True)
class ForecastSystem:
    """A system that was drawn.

    `equations` are its right-hand sides by left-hand side, `weight` is its share of the draws. `since` is the time of
    the first row of its window, and `rows` the number of rows of the window.
    """

    equations: Mapping[str, str]
    weight: float
    since: float
    rows: int


@dataclass(frozen=True, eq=False)
class Forecast:
    """The states after the last row of a trajectory.

    Attributes:
        states: the names of the D states; velocities follow the positions, and measured columns that are computed from
            states come last.
        t: the times (N,); the first one is the time of the last row.
        draws: the states of each draw (M, N, D), in the units of the data; angles are in radians. NaN after a draw
            blows up. A state with an unknown offset includes the offset of its trajectory, as its column does.
        systems: the systems that were drawn, the most probable first.
        trajectory: the name of the trajectory.
        measured_t: the times (R,) of the rows of this trajectory.
        measured: its measured values (R,) by state, NaN where a value is missing or not used.
        measured_range: for each state the range that holds 95 % of its measured values (D, 2).
        noise: standard deviation of the measurement errors by state. They are not part of the bands.
        time: the name of the time column.
        notes: sentences about inputs and draws.
    """

    states: tuple[str, ...]
    t: FloatArray
    draws: FloatArray = field(repr=False)
    systems: tuple[ForecastSystem, ...]
    trajectory: str
    measured_t: FloatArray
    measured: Mapping[str, FloatArray]
    measured_range: FloatArray
    noise: Mapping[str, float]
    time: str = "t"
    notes: tuple[str, ...] = ()

    def __getitem__(self, state: str) -> FloatArray:
        """Return the median (N,) of a state by name; raises KeyError."""
        return np.asarray(self.quantiles[_SHARES.index(0.5), :, self._place(state)])

    def band(self, state: str, level: float = 0.95) -> tuple[FloatArray, FloatArray]:
        """Return the lower and the upper end (N,) of the 50 % or 95 % band of a state by name.

        Raises KeyError for an unknown name, UsageError for another level.
        """
        if level not in _BANDS:
            raise UsageError(f"the level of a band must be 0.5 or 0.95, but {level!r} was given; see `draws`")
        lower, upper = (self.quantiles[place, :, self._place(state)] for place in _BANDS[level])
        return lower, upper

    def _place(self, state: str) -> int:
        if state not in self.states:
            raise KeyError(state)
        return self.states.index(state)

    @cached_property
    def quantiles(self) -> FloatArray:
        """The quantiles (5, N, D) of the draws: 2.5 %, 25 %, median, 75 %, 97.5 %.

        A draw that has blown up is as likely above as below: it counts as infinitely small for the quantiles below the
        median, and as infinitely large for the quantiles above it.
        """
        is_lost = np.isnan(self.draws)
        below, above = (np.sort(np.where(is_lost, end, self.draws), axis=0) for end in (-math.inf, math.inf))
        last = len(self.draws) - 1
        found = [
            below[math.floor(share * last)] if share < 0.5 else above[math.ceil(share * last)] for share in _SHARES
        ]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # all draws have blown up
            found[_SHARES.index(0.5)] = np.nanmedian(self.draws, axis=0)
        return np.array(found)

    @cached_property
    def horizons(self) -> dict[str, float | None]:
        """For each state, the time after the last row within which the forecast is informative; None: to its end.

        Until then the 95 % band is at most half as wide as the range of 95 % of the measured values, which is extended
        to the median of the forecast up to that time: the forecast is worth at least one bit.
        """
        lower, _, median, _, upper = self.quantiles
        low = np.minimum.accumulate(np.fmin(median, self.measured_range[:, 0]), axis=0)
        high = np.maximum.accumulate(np.fmax(median, self.measured_range[:, 1]), axis=0)
        with np.errstate(invalid="ignore"):
            is_known = upper - lower <= _BIT * (high - low)
        found: dict[str, float | None] = {}
        for place, state in enumerate(self.states):
            wide = np.flatnonzero(~is_known[:, place])
            found[state] = float(self.t[max(int(wide[0]) - 1, 0)] - self.t[0]) if len(wide) else None
        return found

    @property
    def horizon(self) -> float | None:
        """The shortest of the `horizons`; None: the forecast of each state says something to its end."""
        return min((end for end in self.horizons.values() if end is not None), default=None)

    @property
    def sentences(self) -> tuple[str, ...]:
        """Sentences about the horizon, the windows, alternative systems, inputs and draws."""
        return self._horizon_sentence, *self._sentences_of_systems, *self.notes

    @property
    def _horizon_sentence(self) -> str:
        if self.horizon is None:
            return f"the forecast of each state is informative to its end, {self.time} = {self.t[-1]:.6g}"
        ends = []
        for state, end in self.horizons.items():
            until = f"until {self.time} = {float(self.t[0]) + (end or 0.0):.4g}" if end else "at no time"
            ends.append(f"of {state} {'to the end' if end is None else until}")
        return (
            f"the forecast is informative {', '.join(ends)}; then its 95 % band is wider than half of the range of "
            "95 % of the measured values"
        )

    @property
    def _sentences_of_systems(self) -> list[str]:
        if not self.systems:
            return []
        first, *others = self.systems
        sentences = [
            f"the state at {self.time} = {self.t[0]:.6g} is fitted to {first.rows} rows of trajectory "
            f"{self.trajectory}, from {self.time} = {first.since:.6g} on"
        ]
        if others:
            count = f"{len(others)} alternative system{'s' if len(others) > 1 else ''}"
            share = 100.0 * sum(system.weight for system in others)
            have = "have" if len(others) > 1 else "has"
            sentences.append(f"{count} {have} {share:.2g} % of the draws, their odds by the fit")
        return sentences

    def __str__(self) -> str:
        return "\n".join(self.sentences)

    def __repr__(self) -> str:
        return first_lines(str(self), "print it")

    def columns(self) -> dict[str, FloatArray]:
        """Return the times and for each state the median, the 95 % band and the 50 % band, by column; each is (N,)."""
        columns = {self.time: self.t}
        for state in self.states:
            columns[state] = self[state]
            for level, suffix in ((0.95, ""), (0.5, "50")):
                columns[f"{state}_lower{suffix}"], columns[f"{state}_upper{suffix}"] = self.band(state, level)
        return columns

    def to_csv(self) -> str:
        """Return the columns as CSV; numbers have all digits."""
        return csv_of({name: values.tolist() for name, values in self.columns().items()})

    def to_frame(self, library: FrameLibrary = "polars") -> "polars.DataFrame | Any":
        """Return the `columns` as a frame of ``"polars"`` or ``"pandas"``; raises UsageError without that library."""
        return frame_of(self.columns(), library)

    def as_dict(self) -> dict[str, object]:
        """Return plain data, as ``coordinator forecast --json`` prints it; numbers that are not finite are None."""
        return plain({
            "schema": SCHEMA, "trajectory": self.trajectory, "last_time": float(self.t[0]), "horizon": self.horizon,
            "horizons": self.horizons, "sentences": self.sentences, "systems": self.systems, "noise": self.noise,
            "measured_range": dict(zip(self.states, self.measured_range, strict=True)), "columns": self.columns(),
        })  # fmt: skip


def forecast(result: Result, request: ForecastRequest, table: Table | None = None, u: GivenInputs = None) -> Forecast:
    """Return a forecast from the last row of a trajectory of a result, or of `table`.

    Args:
        result: the result.
        request: the forecast.
        table: measurements that replace the measurements in the result, such as newer rows.
        u: inputs after the last row by name: numbers, arrays (N,) at the times of the forecast, functions of time or
            curves. A missing input keeps its last value.

    Raises:
        UsageError: a name or number does not fit, the result is not a law of trajectories, or it has no measurements.
        DataError: the data have an error.
        AtollError: the law cannot be simulated.
    """
    model = ModelCore(result)
    model.require_one_group()
    if model.is_regression:
        raise UsageError("the model is a regression without time, so there is nothing to forecast; see its result")
    request.check(len(model.states))
    if model.components:
        return _forecast_process(model, request, table, u)
    law = KnownLaw.of(result, table)
    trajectories = dict(law.trajectories())
    last = trajectories[_chosen([*trajectories], request.trajectory)]
    weighted: Sequence[WeightedSystem] = ()
    if request.has_rivals:
        weighted = alternatives_of(result, law.fitted, ())
    laws = [(replace(law, fitted=system.fitted), system.weight) for system in weighted] or [(law, 1.0)]
    windows = [(each, weight, _last_window(each, last)) for each, weight in laws]
    kept = [(each, weight, window) for each, weight, window in windows if window is not None]
    if not kept:
        raise AtollError(
            "the law cannot be simulated along the last rows, so the state at the last row is not known; give other "
            "rows with data"
        )
    past = law.times_of(last)
    times = request.times(float(past[-1]))
    names = last.variables[len(law.states) :]
    inputs, notes = _inputs_after(model, dict(zip(names, last.inputs[:, -1].tolist(), strict=True)), times, u)
    course = _course(model, names, inputs, times)
    total = math.fsum(weight for _, weight, _ in kept)
    random, ends = np.random.default_rng(request.seed), np.cumsum([weight / total for _, weight, _ in kept])
    counts = np.diff(np.rint(request.draws * ends).astype(int), prepend=0).tolist()
    drawn = [_draw(each, window, count, course, random) for (each, _, window), count in zip(kept, counts, strict=True)]
    draws = np.concatenate(drawn)[:, np.searchsorted(course[0], times)]
    if lost := int(np.isnan(draws[:, -1]).any(axis=1).sum()):
        notes.append(f"{lost} of {len(draws)} draws blow up before the end of the forecast")
    if len(kept) < len(windows):
        notes.append(f"{len(windows) - len(kept)} alternative systems cannot be simulated along the last rows")
    systems = [
        ForecastSystem(
            each.fitted.texts(result), weight / total, float(past[-window.measurements.rows]),
            window.measurements.rows,
        )
        for each, weight, window in kept
    ]  # fmt: skip
    observed = law.shown_columns(last)
    return Forecast(
        states=law.shown,
        t=times,
        draws=draws,
        systems=tuple(sorted(systems, key=lambda system: -system.weight)),
        trajectory=law.measurements.names[int(last.owners[0])],
        measured_t=past,
        measured=dict(zip(observed, np.where(last.weights > 0.0, last.measured, np.nan), strict=True)),
        measured_range=_central_range(_shown_course(law.measurements)),
        noise=dict(zip(observed, law.noise.tolist(), strict=True)),
        time=result.time,
        notes=tuple(notes),
    )


def _chosen(names: Sequence[str], name: str | None) -> str:
    """Return the name of a trajectory; None: the last one. Raises UsageError for an unknown name."""
    if name is None:
        return names[-1]
    if name not in names:
        known = ", ".join(names)
        raise UsageError(f"there is no trajectory {name!r}; the trajectories are {known}{did_you_mean(name, names)}")
    return name


def _shown_course(measurements: TrajectoryMeasurements) -> FloatArray:
    """Return the smoothed states, and then the smoothed columns that are computed from states."""
    computed = measurements.observed >= len(measurements.scales)
    return np.concatenate([measurements.smoothed, measurements.smoothed_columns[computed]])


def _central_range(values: FloatArray) -> FloatArray:
    """Return the range (D, 2) that holds 95 % of the values (D, R)."""
    return np.asarray(np.nanquantile(values, (_SHARES[0], _SHARES[-1]), axis=1).T)


# ----------------------------------------------------------------------------------------- the state at the last row


def _last_window(law: KnownLaw, trajectory: TrajectoryMeasurements) -> StateFit | None:
    """Return the law along the longest window of last rows that determines the last state well.

    A window is twice as long as the previous one, as long as one simulation describes it as well as two. Errors of
    the constants grow along a window, so a longer window may determine it less. The constants were fitted to the
    same rows: the variance of the sum of two such errors is at most twice the sum of their variances. So a shorter
    window is certainly better only if its variance is less than half. With hidden states, the window is the whole
    trajectory.
    """
    if trajectory.hidden:
        return law.fit_states(trajectory)
    rows, numbers = trajectory.rows, len(law.states) + len(trajectory.offset)
    length = min(max(_FEWEST_ROWS, math.ceil(_ROWS_PER_NUMBER * numbers / len(trajectory.observed))), rows)
    last = law.fit_states(cut(trajectory, [(rows - length, rows)]))
    windows = [] if last is None else [last]
    while last is not None and length < rows:
        longer = min(2 * length, rows)
        older = law.fit_states(cut(trajectory, [(rows - longer, rows - length)]))
        both = None
        if older is not None:
            both = law.fit_states(cut(trajectory, [(rows - longer, rows)]), older.fit.starts)
        if older is None or both is None or not law.describes_as_well(both, [older, last]):
            break
        last, length = both, longer
        windows.append(both)
    constants, scales = law.fitted.root @ law.fitted.root.T, trajectory.scales
    uncertainties = [
        float(np.nan_to_num(window.end.variances(constants)[: len(scales)] / scales**2, nan=math.inf).sum())
        for window in windows
    ]
    least = min(uncertainties, default=0.0)
    kept = [window for window, uncertainty in zip(windows, uncertainties, strict=True) if uncertainty <= 2.0 * least]
    return kept[-1] if kept else last


def _draw(
    law: KnownLaw, window: StateFit, count: int, course: tuple[FloatArray, FloatArray, FloatArray],
    random: np.random.Generator,
) -> FloatArray:  # fmt: skip
    """Return the states, and columns computed from them, of `count` draws (M, G, D or more).

    They follow a `course` that begins at the last row, see `_paths`.
    """
    if not count:
        return np.zeros((0, len(course[0]), len(law.shown)))
    end, states = window.end, len(law.states)
    constants, variances = draw_constants(law.fitted, count, random)
    known, directions = eigenaxes(end.spread, 0.0)
    errors = random.standard_normal((count, len(end.mean))) @ (directions * np.sqrt(known)).T
    ends = end.mean + (constants - law.fitted.values) @ end.by_constants.T + np.sqrt(variances)[:, None] * errors
    starts = _with_kept_signs(law, window, ends[:, :states])
    paths = _paths(law, window, starts, constants, course)
    paths[:, :, window.measurements.observed[window.measurements.offset]] += ends[:, None, states:]
    return paths


def _with_kept_signs(law: KnownLaw, window: StateFit, states: FloatArray) -> FloatArray:
    """Return drawn states (M, D), reflected at 0 where the law keeps the sign of a state along the trajectory.

    If such a state, as a population, were 0 at any row, its rate would not point to the other side. A normal draw
    beyond 0 is an error of the approximation.
    """
    whole, system = law.measurements, window.fit.system
    own = whole.owners_of_rows == int(window.measurements.owners[0])
    along = np.concatenate([whole.smoothed, whole.inputs])[:, own]
    rows = [whole.variables.index(name) for name in law.fitted.equations.names]
    signs, states = np.sign(along[: len(law.states)].sum(axis=1)), states.copy()
    for place in np.flatnonzero((states * signs < 0.0).any(axis=0)).tolist():
        points = along.copy()
        points[place] = 0.0
        rates = values_of(system.programs[place], np.ascontiguousarray(points[rows]))
        if (rates * signs[place] >= 0.0).all():
            states[:, place] = np.copysign(states[:, place], signs[place])
    return states


# ------------------------------------------------------------------------------------------------------------- inputs


def _inputs_after(
    model: ModelCore, last: Mapping[str, float], times: FloatArray, u: GivenInputs
) -> tuple[Inputs | None, list[str]]:
    """Return the inputs after the last row, and sentences about inputs that keep a value.

    `last` are the inputs at the last row by symbol. Raises UsageError.
    """
    begin, end, symbols = float(times[0]), float(times[-1]), model.result.symbols
    recorded = {name: InputCurve(times[:1], np.array([value]), np.array([np.nan])) for name, value in last.items()}
    if not isinstance(u, Mapping):
        names: Sequence[str] = model.inputs if u is None else ()
    else:
        given = {symbols.get(name, name): value for name, value in u.items()}
        names = [name for name in model.inputs if name not in given]
        u = {name: _continued(value, last.get(name), begin) for name, value in given.items()}
    inputs = inputs_along(model, u, times, recorded)
    notes = [
        f"the input {name} keeps its last value, {last[name]:.6g}"
        for name in names
        if name in last and model.result.columns_by_symbol[name] != model.time
    ]
    for name, value in u.items() if isinstance(u, Mapping) else ():
        if isinstance(value, InputCurve) and value.times[-1] < end:
            notes.append(
                f"the values of the input {name} end at {model.time} = {value.times[-1]:.6g}; it keeps the last one"
            )
    return inputs, notes


def _continued(value: object, last: float | None, begin: float) -> Any:
    """Return an input; a curve that begins later begins with the last known value."""
    if not isinstance(value, InputCurve) or last is None or value.times[0] <= begin:
        return value
    kind: InputKind = "held" if value.is_held else "shape-preserving"
    return InputCurve.through(np.append(begin, value.times), np.append(last, value.values), kind)


def _course(
    model: ModelCore, names: Sequence[str], inputs: Inputs | None, times: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return times (G,) that include `times` and the rows of inputs, and the inputs `names` there: values and slopes
    (U, G)."""
    functions = inputs.functions if isinstance(inputs, InputFunctions) else ()
    curves = {
        name: curve for name, curve in zip(model.inputs, functions, strict=False) if isinstance(curve, InputCurve)
    }
    knots = [curve.times[(curve.times > times[0]) & (curve.times < times[-1])] for curve in curves.values()]
    grid = np.unique(np.concatenate([times, *knots]))
    if inputs is None:
        return grid, np.zeros((0, len(grid))), np.zeros((0, len(grid)))
    known = dict(zip(model.inputs, np.array([inputs(at) for at in grid.tolist()]).T, strict=True))
    values = np.array([known[name] for name in names])
    slopes = [
        estimate_input_slopes([grid], [row], "held" if name in curves and curves[name].is_held else "shape-preserving")
        for name, row in zip(names, values, strict=True)
    ]
    return grid, values, np.array([row for (row,) in slopes])


# ------------------------------------------------------------------------------------------------------- simulations


def _paths(
    law: KnownLaw, window: StateFit, starts: FloatArray, values: FloatArray,
    course: tuple[FloatArray, FloatArray, FloatArray],
) -> FloatArray:  # fmt: skip
    """Return the states (M, G, D) of draws from `starts` (M, D) with constants `values` (M, P); NaN after a blow-up.

    The columns that are computed from states follow the states. `course` are the times (G,), and the inputs and their
    slopes (U, G).
    """
    fit, measurements, states, times = window.fit, window.measurements, len(law.states), course[0]
    rows = min(max(float(len(times)), float(times[-1] - times[0]) / law.measurements.step), _MOST_ROWS)
    limits, whole = np.tile([-_LARGEST, _LARGEST], (states, 1)), np.array([[0, len(times)]], dtype=np.int64)
    paths, found = np.empty((len(starts), len(times), len(law.shown))), np.empty((states, len(times)))
    for draw, (start, constants) in enumerate(zip(starts, values, strict=True)):
        system = fit.system.with_values(constants).with_fixed_constants()
        for table in (STIFF,) if fit.is_stiff else (PRECISE, STIFF):
            found.fill(np.nan)
            done = integrate_segments(
                table, system.tape, system.owners, course, whole, np.ascontiguousarray(start[None]),
                fit.estimator.tolerance * measurements.scales, limits, 200 + int(STEPS_PER_ROW * rows), False, found,
                np.zeros((0, states, states)), np.zeros(1, np.int64),
            )  # fmt: skip
            if done >= 0:
                break
        paths[draw, :, :states] = found.T
        if law.target.recording.observed:
            points = np.concatenate([found, course[1]])
            computed = [values_of(program, points) for program in system.observation_programs]
            paths[draw, :, states:] = np.where(np.isfinite(found).all(axis=0), computed, np.nan).T
    return paths


def _forecast_process(model: ModelCore, request: ForecastRequest, table: Table | None, u: GivenInputs) -> Forecast:
    """Return a forecast of a stochastic process: paths from the last row of `table`; its result lists no rows."""
    from atoll_coordinator.data.prepare import prepare

    if table is None:
        raise UsageError(
            "the result of a stochastic process has no measurements", python="give them as data",
            command="give the data file with --data",
        )  # fmt: skip
    known = prepare(table, config_of(model.result)).process
    if known is None or {*model.states} - {*known.state_symbols}:
        raise UsageError(f"the data must have measurements of {', '.join(model.states)} over time")
    paths = {path.name: path for path in known.paths}
    name = _chosen([*paths], request.trajectory)
    path, past = paths[name], paths[name].times + known.offset
    if not len(past):
        raise UsageError(f"no row of trajectory {name!r} has a value of every state; give other rows")
    places = [known.state_symbols.index(state) for state in model.states]
    times = request.times(float(past[-1]))
    last = dict(zip(known.input_symbols, path.inputs[:, -1].tolist(), strict=True))
    inputs, notes = _inputs_after(model, last, times, u)
    ensemble = ensemble_of(model, path.states[places, -1], times, inputs, (request.draws, request.seed))
    if len(ensemble.finite) < request.draws:
        notes.append(ensemble.message)
    notes.append("paths of the process begin at the last row; errors of this row and of the constants are left out")
    measured = dict(zip(model.states, path.states[places], strict=True))
    every = np.concatenate([path.states[places] for path in known.paths], axis=1)
    return Forecast(
        model.states, times, ensemble.x, (), name, past, measured, _central_range(every), {}, model.time, tuple(notes)
    )
