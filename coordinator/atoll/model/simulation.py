"""Simulations of a vector field from any initial state, with 95 % bands, and paths of stochastic processes.

LSODA integrates the rates with a relative tolerance of 1e-11. The absolute tolerance of each state is 1e-14 times the
size of this state. The size is the initial value, or the largest measured value if the initial value is 0. A state may
fall far below its size and grow again; its later values then depend on its smallest values. If the first integration
finds such a state, a second integration uses smaller sizes. The number of evaluations of the rates is limited. A
simulation that ends early is not an error: its status gives the reason. 95 % bands come from the sensitivities of the
states to the constants, which are integrated together with the states.

Doubtful: the sizes are a heuristic. If the second integration fails, the first one is kept, with a remark that later
values may be wrong. The bands are first-order and contain only the errors of the constants. They are too narrow if the
initial state or the form of the equation is uncertain. They are unreliable for chaotic models.

Letters: D states, U inputs, K constants, N times.
"""

import contextlib
import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from atoll.model.vector_field import JointErrors, VectorField
from atoll_coordinator.process_steps.moments import StepMoments, predict_step_moments
from atoll_coordinator.process_steps.paths import (
    STEPS,
    Ensemble,
    Simulator,
    StationaryDensity,
    density_of,
    divided,
    settled_paths,
    step_counts,
)
from atoll_coordinator.result.findings import Process
from atoll_core.data.dataset import FloatArray
from atoll_core.data.frames import FrameLibrary, csv_of, frame_of
from atoll_core.errors import UsageError
from atoll_core.expression.text.parsing import from_infix
from atoll_core.quoting import shown

if TYPE_CHECKING:
    import polars

    from atoll.model.core import ModelCore

Status = Literal["finished", "blow-up", "stiff", "undefined"]
"""How a simulation ended: at the last time; because a state grows without bounds in finite time; because the allowed
number of evaluations was used up; or because a rate is undefined."""

Inputs = Callable[[float], FloatArray]
"""The inputs (U,) at a time. Held inputs have `jumps`, the times at which they change: no step crosses a jump."""

TOLERANCE: Final = 1e-11
"""Relative error of a step: far below the errors of the constants."""
MOST_EVALUATIONS: Final = 200_000
"""Largest number of evaluations of the rates: some seconds. A longer simulation can continue from the last state."""
MOST_NUMBERS: Final = 10_000_000
"""Largest number of values, times by states: 80 MB."""
_COARSE: Final = 1e-3
"""If a state is below this share of its size, its absolute tolerance exceeds its relative tolerance."""
_SMALLEST_SHARE: Final = 1e-250
"""A state that cannot cross 0 is resolved down to this share of its size."""
_TESTED_ROWS: Final = 50
"""Number of rows at which two things are tested: which states can cross 0, and how much the errors of the constants
change the rates."""
_LARGEST: Final = 1e150
"""Largest absolute value of a state: the square of a much larger number overflows."""
_ROUGH_REMARK: Final = "; a state falls below the resolved size: if it grows again, later values may be wrong"


class SimulationWarning(UserWarning):
    """A limitation of a simulation that users have to know."""


class EarlyEndWarning(SimulationWarning):
    """A simulation has ended before the last requested time; it has only the times and states that were reached."""


class ExtrapolationWarning(SimulationWarning):
    """The initial state of a simulation is outside of the measured range."""


class ColumnCurve(NamedTuple):
    """A state or a computed column along a simulation: values, standard errors and the 95 % band (N,); None: not
    known."""

    values: FloatArray
    stderr: FloatArray | None = None
    lower: FloatArray | None = None
    upper: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class SimulationResult:
    """A simulation of a model from an initial state.

    `t` (N,) are the times that were reached: fewer than requested if the simulation ended early. `x` (N, D) are the
    `states` at these times. `stderr` (N, D) are standard errors, propagated from the constants to first order. `lower`
    and `upper` (N, D) are the 95 % band. All three are None if the errors of the constants are not known. `status` says
    how the simulation ended, and `message` says it in a sentence. `remark` names the initial values outside of the
    measured range; it is "" if there are none. `observed` are the measured columns that are computed from states.
    """

    states: tuple[str, ...]
    t: FloatArray
    x: FloatArray
    status: Status
    message: str
    stderr: FloatArray | None = None
    lower: FloatArray | None = None
    upper: FloatArray | None = None
    time: str = "t"
    remark: str = ""
    observed: Mapping[str, ColumnCurve] = field(default_factory=dict)

    @cached_property
    def curves(self) -> dict[str, ColumnCurve]:
        """The values (N,) of the states, and then of the observed columns, by name, with their bands."""
        spreads = [[None] * len(self.states) if of is None else [*of.T] for of in (self.stderr, self.lower, self.upper)]
        return dict(zip(self.states, map(ColumnCurve, self.x.T, *spreads), strict=True)) | dict(self.observed)

    def __getitem__(self, state: str) -> FloatArray:
        """Return the values (N,) of a state or an observed column by name; raises KeyError for an unknown name."""
        return self.curves[state].values

    def __repr__(self) -> str:
        names, count = ", ".join((*self.states, *self.observed)), len(self.t)
        times = f"{count} times from {self.t[0]:.6g} to {self.t[-1]:.6g}" if count > 1 else f"time {self.t[0]:.6g}"
        bands = ", with 95 % bands" if self.lower is not None else ""
        remark = f"; {self.remark}" if self.remark else ""
        return f"<Simulation of {names}: {times}{bands}; {self.status}: {self.message}{remark}>"

    def band(self, state: str) -> tuple[FloatArray, FloatArray]:
        """Return the lower and the upper bound (N,) of the 95 % band of a state or an observed column, by name.

        Raises KeyError for an unknown name, UsageError if the errors of the constants are not known.
        """
        curve = self.curves[state]
        if curve.lower is None or curve.upper is None:
            raise UsageError(
                f"there is no band of {shown(state)}: the errors of the constants are not known or not propagated; "
                "params has the constants with their errors"
            )
        return curve.lower, curve.upper

    def to_frame(self, library: FrameLibrary = "polars") -> "polars.DataFrame | Any":
        """Return the `columns` as a frame of ``"polars"`` or ``"pandas"``; raises UsageError without that library."""
        return frame_of(self.columns(), library)

    def columns(self) -> dict[str, FloatArray]:
        """Return the times, the states, the observed columns and, if they are known, their bands, by column name.

        Each is (N,).
        """
        columns = {self.time: self.t} | {name: curve.values for name, curve in self.curves.items()}
        for name, curve in self.curves.items():
            if curve.lower is not None and curve.upper is not None:
                columns |= {f"{name}_lower": curve.lower, f"{name}_upper": curve.upper}
        return columns

    def to_csv(self) -> str:
        """Return the columns as CSV; numbers have all digits."""
        return csv_of({name: values.tolist() for name, values in self.columns().items()})

    def as_dict(self) -> dict[str, object]:
        """Return lists and texts for JSON; numbers that are not finite are None."""
        columns = {
            name: [value if math.isfinite(value) else None for value in values.tolist()]
            for name, values in self.columns().items()
        }
        return {"status": self.status, "message": self.message, "remark": self.remark, "columns": columns}


def simulate(  # noqa: PLR0913, the parts of a simulation
    field: VectorField,
    x0: FloatArray,
    t: FloatArray,
    inputs: Inputs | None = None,
    bands: tuple[JointErrors, float] | None = None,
    most: int = MOST_EVALUATIONS,
    observed: VectorField | None = None,
) -> SimulationResult:
    """Integrate from the state `x0` (D,) at the first of the ascending times `t` (N,).

    LSODA takes implicit steps where the system is stiff. `bands` are the errors of the constants and the half width of
    a band in standard errors. `most` limits the number of evaluations. `observed` are columns that are computed from
    the states. Raises UsageError for invalid arguments.
    """
    check_times(field, x0, t)
    task = _RateTask(field, inputs, most)
    course = _integrate(task, x0, t)
    states, count = course.rows, len(course.rows)
    status: Status = (
        "finished" if course.is_whole else _early_end(task, course, _sizes(task, x0, t), float(t[-1] - t[0]))
    )
    where = f"time {course.reached:.6g}"
    sentence = {
        "finished": f"it reached {where}",
        "blow-up": f"a state grows without bounds near {where}",
        "stiff": f"{most} evaluations only reach {where}: the model is stiff or very fast; simulate a shorter time",
        "undefined": f"a rate is undefined near {where}",
    }[status]
    sentence += "" if course.is_whole else f"; {count} of {len(t)} times were reached"
    sentence += _ROUGH_REMARK if course.is_rough else ""
    found = None if bands is None or status != "finished" else _sensitivities(task, bands[0], course, t)
    spread = None if found is None else np.sqrt(np.einsum("dkn,dkn->nd", found[0], found[0]))
    curves = dict[str, ColumnCurve]()
    if observed is not None and observed.outputs:
        driven = None if inputs is None else np.array([inputs(at) for at in t[:count].tolist()])
        curves = _column_curves(observed, states, driven, None if bands is None or found is None else (*bands, *found))
    reach = None if spread is None or bands is None else bands[1] * spread
    lower, upper = (None, None) if reach is None else (states - reach, states + reach)
    return SimulationResult(field.states, t[:count], states, status, sentence, spread, lower, upper, observed=curves)


def _column_curves(
    columns: VectorField, x: FloatArray, u: FloatArray | None,
    errors: tuple[JointErrors, float, FloatArray, FloatArray] | None,
) -> dict[str, ColumnCurve]:  # fmt: skip
    """Return the `columns` at states `x` (N, D) and inputs `u` (N, U).

    The standard errors are first-order: of the states, and of the constants of the columns, which are fitted together.
    They follow from the changes of states (D, M, N) and constants (K, M) along independent directions. None: there are
    no standard errors.
    """
    names, values = columns.outputs or (), columns.values(x, u)
    if errors is None:
        return dict(zip(names, map(ColumnCurve, values.T), strict=True))
    joint, width, sensitivities, root = errors
    owners, own = [one.variable for one in columns.parameters], np.zeros((len(columns.parameters), root.shape[1]))
    for (column, number), change in zip(joint.observed, root[len(joint.columns) :], strict=True):
        own[owners.index(column) + number] = change
    changes = np.einsum("nod,dmn->nom", columns.jacobian(x, u), sensitivities)
    spread = np.sqrt(((changes + columns.parameter_derivatives(x, u) @ own) ** 2).sum(axis=2))
    ends = values - width * spread, values + width * spread
    return dict(zip(names, map(ColumnCurve, values.T, spread.T, *(end.T for end in ends)), strict=True))


def state_sizes(
    field: VectorField, x0: FloatArray, t: FloatArray, inputs: Inputs | None = None, most: int = MOST_EVALUATIONS
) -> FloatArray:
    """Return the size (D,) of each state, above 0, for the absolute tolerances of a solver.

    The arguments are as in `simulate`. Raises UsageError for invalid arguments.
    """
    check_times(field, x0, t)
    course = _integrate(_RateTask(field, inputs, most), x0, t)
    return np.maximum(course.sizes, np.minimum(course.lowest, np.abs(x0)))


def check_times(field: VectorField, x0: FloatArray, t: FloatArray, paths: int = 1) -> None:
    """Raise UsageError for an invalid initial state, invalid times, or too many values of `paths` paths."""
    if x0.shape != (len(field.states),) or not np.isfinite(x0).all():
        raise UsageError(f"an initial state must have a finite number for each of {', '.join(field.states)}")
    if t.ndim != 1 or len(t) < 1 or not np.isfinite(t).all() or (np.diff(t) <= 0.0).any():
        raise UsageError("times must be finite and ascending; give at least one time")
    if paths * len(t) * len(x0) > MOST_NUMBERS:
        what = f"{len(t)} times of {len(x0)} states" + (f" on {paths} paths" if paths > 1 else "")
        raise UsageError(f"{what} are more than {MOST_NUMBERS} numbers; take longer steps")


class _SpentError(Exception):
    """The allowed number of evaluations is used up."""


@dataclass
class _RateTask:
    """The rates for a solver, with a `count` of evaluations, of which `most` are allowed."""

    field: VectorField
    inputs: Inputs | None
    most: int
    count: int = 0
    before: float = math.inf
    """From this time on, inputs keep the values that they have just before it."""

    @property
    def is_spent(self) -> bool:
        """Whether the allowed number of evaluations is used up."""
        return self.count > self.most

    def inputs_at(self, t: float) -> FloatArray | None:
        """Return the inputs (U,) at a time; None for a model without inputs."""
        return None if self.inputs is None else np.asarray(self.inputs(min(t, self.before)), dtype=np.float64)

    def spans(self, begin: float, end: float) -> Iterator[tuple[float, float]]:
        """Yield the intervals between jumps of inputs.

        Until the next interval is taken, `inputs_at` returns the values inside the interval, also at its end.
        """
        jumps = np.asarray(getattr(self.inputs, "jumps", ()), dtype=np.float64)
        times = [begin, *jumps[(jumps > begin) & (jumps < end)].tolist(), end]
        for first, last in pairwise(times):
            self.before = math.nextafter(last, first) if last < end else math.inf
            yield first, last
        self.before = math.inf

    def rates(self, t: float, x: FloatArray) -> FloatArray:
        """Return dx/dt (D,)."""
        self.count += 1
        if self.is_spent:
            raise _SpentError
        return self.field.values(x, self.inputs_at(t))

    def jacobian(self, t: float, x: FloatArray) -> FloatArray:
        """Return d(dx/dt)/dx (D, D), with 0 for entries that are not finite: there the rates end the integration."""
        return np.nan_to_num(self.field.jacobian(x, self.inputs_at(t)))


@dataclass(frozen=True, eq=False)
class _Integration:
    """The states `rows` (n, D) at the first n times, the last time `reached`, and the `last` state (D,) at that time.

    `sizes` (D,) are the sizes for the absolute tolerances. `lowest` (D,) are the smallest absolute values of all steps.
    `is_whole`: the last time was reached. `is_spent`: the allowed number of evaluations was used up. `is_rough`: a
    state fell below the resolved size, and the integration with smaller sizes failed.
    """

    rows: FloatArray
    reached: float
    last: FloatArray
    sizes: FloatArray
    lowest: FloatArray
    is_whole: bool
    is_spent: bool = False
    is_rough: bool = False


def _integrate(task: _RateTask, x0: FloatArray, t: FloatArray) -> _Integration:
    """Integrate from `x0` (D,), and again with smaller sizes if states turn out to be smaller than assumed."""
    begin, sizes = float(t[0]), _sizes(task, x0, t)
    if len(t) == 1 or not np.isfinite(task.field.values(x0, task.inputs_at(begin))).all():
        return _Integration(np.array([x0]), begin, x0, sizes, np.abs(x0), is_whole=len(t) == 1)
    course = _integrate_once(task, x0, t, sizes)
    smaller = sizes if course.is_spent else _smaller_sizes(task, course, t)
    if (smaller == sizes).all():
        return course
    task.count = 0
    finer = _integrate_once(task, x0, t, smaller)
    return finer if finer.is_whole else replace(course, is_rough=course.is_whole)


def _smaller_sizes(task: _RateTask, course: _Integration, t: FloatArray) -> FloatArray:
    """Return the sizes (D,) for a second integration: smaller for states that are far below the assumed size."""
    reached, sizes = np.abs(course.rows).max(axis=0), course.sizes.copy()
    if course.is_whole:
        is_small = (reached > 0.0) & (reached < _COARSE * sizes)
        sizes = np.where(is_small.any() & (reached > 0.0), np.minimum(reached, sizes), sizes)
    is_deep = (course.lowest < _COARSE * course.sizes) & (course.rows[0] != 0.0)
    deep = [place for place in np.flatnonzero(is_deep).tolist() if not _can_cross(task, course, t, place)]
    sizes[deep] = np.maximum(_SMALLEST_SHARE * sizes[deep], np.finfo(np.float64).tiny)
    return sizes


def _can_cross(task: _RateTask, course: _Integration, t: FloatArray, place: int) -> bool:
    """Tell whether a state can change its sign: its rate at 0 points away from its initial sign.

    The signs of the integrated states are no evidence: below the tolerance they are the signs of integration errors.
    """
    sign = float(np.sign(course.rows[0, place]))
    for row in np.unique(np.linspace(0, len(course.rows) - 1, _TESTED_ROWS).astype(int)).tolist():
        x = course.rows[row].copy()
        x[place] = 0.0
        with np.errstate(all="ignore"):
            rate = float(task.field.values(x, task.inputs_at(float(t[row])))[place])
        if not sign * rate >= 0.0:
            return True
    return False


def _integrate_once(task: _RateTask, x0: FloatArray, t: FloatArray, sizes: FloatArray) -> _Integration:
    """Integrate with absolute tolerances in proportion to the `sizes` (D,)."""
    from scipy.integrate import LSODA

    rows, reached, last, lowest = [x0.copy()], float(t[0]), x0, np.abs(x0)
    with contextlib.suppress(_SpentError), warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        least = TOLERANCE * _COARSE * sizes
        for first, final in task.spans(reached, float(t[-1])):
            solver = LSODA(task.rates, first, last, final, rtol=TOLERANCE, atol=least, jac=task.jacobian)
            while solver.status == "running":
                solver.step()
                if solver.status == "failed" or not np.isfinite(solver.y).all():
                    break
                reached, last = float(solver.t), solver.y.copy()
                lowest = np.minimum(lowest, np.abs(last))
                if np.abs(last).max() > _LARGEST:
                    break
                if len(rows) < len(t) and t[len(rows)] <= solver.t:  # the last step has passed some of the times
                    dense, end = solver.dense_output(), int(np.searchsorted(t, solver.t, side="right"))
                    rows += [np.asarray(dense(at)) for at in t[len(rows) : end].tolist()]
            if solver.status != "finished":
                break
    return _Integration(np.array(rows), reached, last, sizes, lowest, len(rows) == len(t), task.is_spent)


def _sizes(task: _RateTask, x0: FloatArray, t: FloatArray) -> FloatArray:
    """Return the size (D,) of each state, above 0: its absolute initial value.

    If the initial value is 0, the size is the largest measured value. Without data it is the value after D steps of
    Euler's method: after D steps, growth has passed from any state to any other. A state that stays 0 has size 1.
    """
    sizes = np.abs(x0)
    if task.field.sizes:
        sizes = np.where(sizes > 0.0, sizes, task.field.sizes)
    x, step = x0, float(t[1] - t[0]) if len(t) > 1 else 0.0
    for _ in x0 if (sizes == 0.0).any() else ():
        with np.errstate(all="ignore"):
            x = x + step * np.nan_to_num(task.field.values(x, task.inputs_at(float(t[0]))))
        sizes = np.where((sizes == 0.0) & np.isfinite(x), np.abs(x), sizes)
    return _positive(sizes)


def _early_end(task: _RateTask, course: _Integration, sizes: FloatArray, span: float) -> Status:
    """Return why a simulation ended early, from its last state; `sizes` (D,) are the initial sizes of the states."""
    last = course.last
    rates = task.field.values(last, task.inputs_at(course.reached))
    with np.errstate(all="ignore"):  # the time in which a growing state doubles
        is_growing = (last * rates > 0.0) & (np.abs(last) > sizes)
        doubling = float(np.where(is_growing, np.abs(last / rates), np.inf).min())
    if np.abs(last).max() > _LARGEST or doubling < math.sqrt(TOLERANCE) * span:
        return "blow-up"
    return "stiff" if course.is_spent else "undefined"


def _sensitivities(
    task: _RateTask, errors: JointErrors, course: _Integration, t: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Return the changes (D, M, N) of the simulated states along M directions of the constants with unit variance, from
    S' = J S + df/dc, and the changes (K, M) of the constants along these directions.

    None if the sensitivities cannot be integrated.
    """
    states = course.rows
    x0, (rows, size) = states[0], states.shape
    values, vectors = np.linalg.eigh(errors.covariance)
    kept = values > 0.0
    root = vectors[:, kept] * np.sqrt(values[kept])  # (K, M): M independent directions of unit variance
    number = root.shape[1]
    if not len(errors.columns) or not number or len(t) == 1:
        return np.zeros((size, number, len(t))), root
    sizes = _positive(np.abs(states).max(axis=0))
    some = np.unique(np.linspace(0, rows - 1, _TESTED_ROWS).astype(int))
    driven = np.array([errors.rates(states[row], task.inputs_at(float(t[row]))) @ root for row in some])
    # sensitivities are linear: each direction is scaled so that states change by about their own size
    shares = _positive(np.nan_to_num((np.abs(driven) / sizes[:, None]).max(axis=(0, 1)) * float(t[-1] - t[0])))

    def rates(at: float, y: FloatArray) -> FloatArray:
        x, s = y[:size], y[size:].reshape(size, number)
        slope = task.jacobian(at, x) @ s + errors.rates(x, task.inputs_at(at)) @ (root / shares)
        return np.concatenate([task.rates(at, x), slope.ravel()])

    task.count = 0
    start = np.concatenate([x0, np.zeros(size * number)])
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            small = np.where(_has_deep_minimum(states), np.minimum(course.lowest, sizes), sizes)
            least = 1e-9 * np.concatenate([small, np.repeat(small, number)])
            solution = _solve(task, rates, start, t, least)
    except _SpentError:
        return None
    if solution is None:
        return None
    return solution[size:].reshape(size, number, len(t)) * shares[:, None], root


def _solve(
    task: _RateTask,
    rates: Callable[[float, FloatArray], FloatArray],
    start: FloatArray,
    t: FloatArray,
    least: FloatArray,
) -> FloatArray | None:
    """Return the solution (M, N) from `start` (M,) with absolute tolerances `least` (M,); None if the solver fails."""
    from scipy.integrate import solve_ivp

    found = np.empty((len(start), len(t)))
    for first, last in task.spans(float(t[0]), float(t[-1])):
        rows = (t >= first) & (t <= last)
        times = np.unique(np.append(t[rows], last))
        solution = solve_ivp(rates, (first, last), start, "LSODA", times, rtol=1e-6, atol=least)
        if solution.status != 0:
            return None
        found[:, rows] = solution.y[:, : int(rows.sum())]
        start = solution.y[:, -1]
    return found


def _has_deep_minimum(states: FloatArray) -> npt.NDArray[np.bool_]:
    """Tell which of the D states (N, D) have a deep minimum between higher values: later values depend on its depth."""
    course = np.abs(states)
    lowest = course.argmin(axis=0)
    later = np.array([course[row:, place].max() for place, row in enumerate(lowest.tolist())])
    lows = course.min(axis=0)
    is_deep = lows < _COARSE * np.minimum(course[0], later)
    return np.asarray(is_deep & (later > math.sqrt(_SMALLEST_SHARE) * course[0]))


def _positive(sizes: FloatArray) -> FloatArray:
    """Return sizes with 1 instead of 0: the size of a state that is always 0 does not matter."""
    return np.where(sizes > 0.0, sizes, 1.0)


MOST_STEPS: Final = 200_000
"""Largest number of time steps of an ensemble; they take some minutes."""


def ensemble_of(
    model: "ModelCore", x0: FloatArray, times: FloatArray, inputs: Inputs | None, drawn: tuple[int, int]
) -> Ensemble:
    """Return random paths from `x0` (D,) at the first of the ascending `times` (N,).

    Time steps are at most the sampling interval of the measurements. During a step, `inputs` have their value in the
    middle of the step. `drawn` is the number of paths and the seed. Raises UsageError.
    """
    simulator, longest = _simulator(model, *drawn), process_of(model).step
    check_times(model.field, x0, times, drawn[0])
    count = float(step_counts(times, longest).sum())
    if count > MOST_STEPS:
        needed = f"the simulation needs {count:.15g} steps of {longest:g} (the sampling interval)"
        raise UsageError(f"{needed}, more than {MOST_STEPS}; simulate a shorter time")
    begins, lengths, is_kept = divided(times, longest)
    middles = (begins + 0.5 * lengths).tolist()
    held = np.zeros((0, len(middles))) if inputs is None else np.array([inputs(at) for at in middles]).T
    paths = simulator.paths(np.repeat(x0[:, None], drawn[0], axis=1), held, lengths, is_kept)
    return Ensemble(model.states, times, paths.transpose(2, 0, 1), model.time)


def density_of_process(
    model: "ModelCore", x0: FloatArray, inputs: Sequence[float], drawn: tuple[int, int]
) -> StationaryDensity | None:
    """Return the stationary density with constant `inputs` (U,); None if paths from `x0` (D,) do not become stationary.

    `drawn` is the number of paths and the seed. Raises UsageError.
    """
    simulator = _simulator(model, *drawn, least=2)  # a single path has no standard error of the mean
    check_times(model.field, x0, np.zeros(1))
    most = MOST_NUMBERS // ((STEPS + 1) * len(x0))
    if drawn[0] > most:
        raise UsageError(f"{drawn[0]} paths are more than {most}, the largest number for a density; draw fewer")
    starts = np.repeat(x0[:, None], drawn[0], axis=1)
    paths = settled_paths(simulator, starts, np.array(inputs), process_of(model).step)
    return None if paths is None else density_of(model.states, paths)


def process_of(model: "ModelCore") -> Process:
    """Return the stochastic process; raises UsageError if the model has no noise, or its result has no 'process'."""
    process = model.result.process
    if not model.components:
        raise UsageError("the model has no noise, so it has no random paths; --stochastic finds models with noise")
    if process is None:
        raise UsageError("the result has equations of noise but no 'process'; give the complete result")
    return process


def _simulator(model: "ModelCore", paths: int, seed: int, *, least: int = 1) -> Simulator:
    for name, value, lower in (("paths", paths, least), ("seed", seed, 0)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < lower:
            raise UsageError(f"{name} must be a whole number of at least {lower}, but {value!r} was given")
    names = (*model.states, *model.inputs)
    texts = {equation.variable: equation.exact for equation in model.equations}
    diffusion = {pair: from_infix(texts[name], names) for name, pair in model.components.items()}
    drift, discretisation = model.field.programs, process_of(model).discretisation

    def moments(points: FloatArray, lengths: FloatArray) -> StepMoments:
        return predict_step_moments(drift, diffusion, points, lengths, discretisation)

    return Simulator(moments, np.random.default_rng(seed))
