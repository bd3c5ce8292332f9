"""Simulations of a vector field from any initial state, with bands. Bounded: how it ends is a result, not an error.

Letters: D states, U inputs, K constants, N times.
"""

import contextlib
import csv
import io
import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from atoll.data.dataset import FloatArray
from atoll.errors import UsageError
from atoll.model.parameters import JointErrors
from atoll.model.vector_field import VectorField

Status = Literal["finished", "blow-up", "stiff", "undefined"]
"""How a simulation ended: at the last time; where a state grows beyond all bounds in finite time; where all evaluations
were used up; where a rate has no finite value."""

Inputs = Callable[[float], FloatArray]
"""The inputs (U,) at a time."""

TOLERANCE: Final = 1e-11
"""Relative error of a step; far below the errors of constants."""
MOST_EVALUATIONS: Final = 200_000
"""Evaluations of the rates: some seconds. A longer simulation is begun again from where this one ended."""
MOST_NUMBERS: Final = 10_000_000
"""Largest number of values, times by states: 80 MB."""
_COARSE: Final = 1e-3
"""Of the size of a state: below it errors are allowed that are `TOLERANCE` of so much, and no longer of the state."""
_LOOKS: Final = 50
"""Rows of a simulation at which is seen how strongly errors of constants drive it."""
_LARGEST: Final = 1e150
"""The square of a larger number is no finite one."""


class EarlyEndWarning(UserWarning):
    """A simulation has ended before the last time that was asked for; its times and states are those reached."""


@dataclass(frozen=True, eq=False)
class Simulation:
    """What a model does from an initial state.

    `t` (N,) are the times that were reached, fewer than were asked for where it ended early, and `x` (N, D) the
    `states` there; `stderr` (N, D) are the standard errors that those of the constants give them (first order), and
    `lower`, `upper` their 95 % band; None where the errors of the constants are not known. `status` says how it ended,
    `message` in a sentence.
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

    def __getitem__(self, state: str) -> FloatArray:
        """Return the values (N,) of a state by name; raises KeyError."""
        if state not in self.states:
            raise KeyError(state)
        return np.asarray(self.x[:, self.states.index(state)])

    def columns(self) -> dict[str, FloatArray]:
        """Return the time, the states and, where they are known, the bounds of their bands, by column name."""
        found = {self.time: self.t}
        found |= {name: self.x[:, place] for place, name in enumerate(self.states)}
        if self.lower is not None and self.upper is not None:
            for place, name in enumerate(self.states):
                found[f"{name}_lower"] = self.lower[:, place]
                found[f"{name}_upper"] = self.upper[:, place]
        return found

    def to_csv(self) -> str:
        """Return the columns as CSV, numbers with all their digits."""
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        columns = self.columns()
        writer.writerow(columns)
        writer.writerows(zip(*(map(repr, values.tolist()) for values in columns.values()), strict=True))
        return stream.getvalue()

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain lists and texts, for JSON; numbers that are not finite are None."""
        columns = {name: [_finite(each) for each in values.tolist()] for name, values in self.columns().items()}
        return {"status": self.status, "message": self.message, "columns": columns}


def simulate(
    field: VectorField,
    x0: FloatArray,
    t: FloatArray,
    inputs: Inputs | None = None,
    bands: tuple[JointErrors, float] | None = None,
    most: int = MOST_EVALUATIONS,
) -> Simulation:
    """Integrate from `x0` (D,) at the first of the times `t` (N,), which ascend.

    By LSODA, which takes implicit steps where the system is stiff. `bands` are the errors of the constants and how many
    standard errors lie on either side; `most` bounds the evaluations. Raises UsageError where arguments do not fit.
    """
    check_times(field, x0, t)
    task = _Task(field, inputs, most)
    states, reached, last = _integrated(task, x0, t)
    status: Status = (
        "finished" if last is None else _ending(task, _sizes(task, x0, t), reached, last, float(t[-1] - t[0]))
    )
    count = len(states)
    sentence = _sentence(status, reached, most) + ("" if last is None else f"; {count} of {len(t)} times were reached")
    if bands is None or status != "finished" or (spread := _standard_errors(task, bands[0], states, t)) is None:
        return Simulation(field.states, t[:count], states, status, sentence)
    half = bands[1] * spread
    return Simulation(field.states, t, states, status, sentence, spread, states - half, states + half)


def check_times(field: VectorField, x0: FloatArray, t: FloatArray, paths: int = 1) -> None:
    """Raise UsageError where an initial state or times are none, or so many paths are too many numbers."""
    if x0.shape != (len(field.states),) or not np.isfinite(x0).all():
        raise UsageError(f"an initial state has a finite number for each of {', '.join(field.states)}; correct it")
    if t.ndim != 1 or len(t) < 1 or not np.isfinite(t).all() or (np.diff(t) <= 0.0).any():
        raise UsageError("times must be finite and ascend; give at least one")
    if paths * len(t) * len(x0) > MOST_NUMBERS:
        what = f"{len(t)} times of {len(x0)} states" + (f" on {paths} paths" if paths > 1 else "")
        raise UsageError(f"{what} are more than {MOST_NUMBERS} numbers; take longer steps")


class _SpentError(Exception):
    """All evaluations are used up."""


class _Task:
    """The rates as a solver wants them: counted, and bounded."""

    def __init__(self, field: VectorField, inputs: Inputs | None, most: int) -> None:
        self.field = field
        self._inputs = inputs
        self._most = most
        self._count = 0

    @property
    def is_spent(self) -> bool:
        """Whether all evaluations are used up."""
        return self._count > self._most

    def inputs_at(self, t: float) -> FloatArray | None:
        """Return the inputs at a time; None where there are none."""
        return None if self._inputs is None else np.asarray(self._inputs(t), dtype=np.float64)

    def rates(self, t: float, x: FloatArray) -> FloatArray:
        """Return dx/dt."""
        self._count += 1
        if self.is_spent:
            raise _SpentError
        return self.field.values(x, self.inputs_at(t))

    def jacobian(self, t: float, x: FloatArray) -> FloatArray:
        """Return d(dx/dt)/dx, 0 where it has no finite value: the solver's steps end there by the rates."""
        return np.nan_to_num(self.field.jacobian(x, self.inputs_at(t)))

    def begin_again(self) -> None:
        """Forget the evaluations."""
        self._count = 0


def _integrated(task: _Task, x0: FloatArray, t: FloatArray) -> tuple[FloatArray, float, FloatArray | None]:
    """Return the states at the times that were reached, and the last time.

    Also the last state (D,) where the integration ended early; None where it did not.
    """
    begin, sizes = float(t[0]), _sizes(task, x0, t)
    if len(t) == 1 or not np.isfinite(task.field.values(x0, task.inputs_at(begin))).all():
        return np.array([x0]), begin, None if len(t) == 1 else x0
    found = _attempt(task, x0, t, sizes)
    reached = np.abs(found[0]).max(axis=0)
    if found[2] is not None or not ((reached > 0.0) & (reached < _COARSE * sizes)).any():
        return found
    task.begin_again()  # what the size was taken to be was too large
    finer = _attempt(task, x0, t, np.where(reached > 0.0, np.minimum(reached, sizes), sizes))
    return finer if finer[2] is None else found


def _attempt(
    task: _Task, x0: FloatArray, t: FloatArray, sizes: FloatArray
) -> tuple[FloatArray, float, FloatArray | None]:
    """Return what `_integrated` does, each state with errors that are small beside its own size (D,)."""
    from scipy.integrate import LSODA

    rows, reached, last = [x0.copy()], float(t[0]), x0
    with contextlib.suppress(_SpentError), warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        least = TOLERANCE * _COARSE * sizes
        solver = LSODA(task.rates, reached, x0, float(t[-1]), rtol=TOLERANCE, atol=least, jac=task.jacobian)
        while solver.status == "running":
            solver.step()
            if solver.status == "failed" or not np.isfinite(solver.y).all():
                break
            reached, last = float(solver.t), solver.y.copy()
            if np.abs(last).max() > _LARGEST:
                break
            _take_rows(rows, t, solver)
    return np.array(rows), reached, None if len(rows) == len(t) else last


def _sizes(task: _Task, x0: FloatArray, t: FloatArray) -> FloatArray:
    """Return how large each state is, (D,), all above 0: its initial value, which is what a course can grow from.

    Where that is 0, the largest one measured; of a model without data what the first steps of Euler's method make of
    it, as many as there are states, since each passes on what it has to others; else, of what stays 0 until an input
    comes, 1, until the simulation tells.
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


def _take_rows(rows: list[FloatArray], t: FloatArray, solver: Any) -> None:
    """Add the states at the times that the last step of a solver has passed."""
    if len(rows) < len(t) and t[len(rows)] <= solver.t:
        dense = solver.dense_output()
        end = int(np.searchsorted(t, solver.t, side="right"))
        rows += [np.asarray(dense(at)) for at in t[len(rows) : end].tolist()]


def _ending(task: _Task, sizes: FloatArray, reached: float, last: FloatArray, span: float) -> Status:
    """Return why a simulation ended early, from the last state that was reached; `sizes` (D,) are those at first."""
    rates = task.field.values(last, task.inputs_at(reached))
    with np.errstate(all="ignore"):  # the time in which a state that grows gets twice as large
        is_growing = (last * rates > 0.0) & (np.abs(last) > sizes)
        doubling = float(np.where(is_growing, np.abs(last / rates), np.inf).min())
    if np.abs(last).max() > _LARGEST or doubling < math.sqrt(TOLERANCE) * span:
        return "blow-up"
    return "stiff" if task.is_spent else "undefined"


def _sentence(status: Status, reached: float, most: int) -> str:
    where = f"time {reached:.6g}"
    return {
        "finished": f"it reached {where}",
        "blow-up": f"a state grows beyond all bounds near {where}",
        "stiff": f"{most} evaluations lead to {where} only: the model is stiff or very fast there; simulate less time",
        "undefined": f"a rate has no finite value near {where}",
    }[status]


def _standard_errors(task: _Task, errors: JointErrors, states: FloatArray, t: FloatArray) -> FloatArray | None:
    """Return the standard errors (N, D) of simulated `states` (N, D), by the sensitivities S' = J S + df/dc.

    None where they cannot be followed.
    """
    x0, (rows, size) = states[0], states.shape
    values, vectors = np.linalg.eigh(errors.covariance)
    kept = values > 0.0
    root = vectors[:, kept] * np.sqrt(values[kept])  # (K, M): sensitivities to directions of unit variance
    number = root.shape[1]
    if not len(errors.columns) or not number or len(t) == 1:
        return np.zeros((len(t), size))
    sizes = _positive(np.abs(states).max(axis=0))
    some = np.unique(np.linspace(0, rows - 1, _LOOKS).astype(int))
    driven = np.array([errors.rates(states[row], task.inputs_at(float(t[row]))) @ root for row in some])
    # sensitivities are linear in a direction: each is followed at the size at which states move by about their own
    shares = _positive(np.nan_to_num((np.abs(driven) / sizes[:, None]).max(axis=(0, 1)) * float(t[-1] - t[0])))

    def rates(at: float, y: FloatArray) -> FloatArray:
        x, s = y[:size], y[size:].reshape(size, number)
        slope = task.jacobian(at, x) @ s + errors.rates(x, task.inputs_at(at)) @ (root / shares)
        return np.concatenate([task.rates(at, x), slope.ravel()])

    from scipy.integrate import solve_ivp

    task.begin_again()
    start = np.concatenate([x0, np.zeros(size * number)])
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            least = 1e-9 * np.concatenate([sizes, np.repeat(sizes, number)])
            found = solve_ivp(rates, (float(t[0]), float(t[-1])), start, "LSODA", t, rtol=1e-6, atol=least)
    except _SpentError:
        return None
    if found.status != 0:
        return None
    sensitivities = found.y[size:].reshape(size, number, len(t)) * shares[:, None]
    return np.asarray(np.sqrt(np.einsum("dkn,dkn->nd", sensitivities, sensitivities)))


def _positive(sizes: FloatArray) -> FloatArray:
    """Return sizes, 1 in the place of 0: what is always 0 has none, and errors of it are none."""
    return np.where(sizes > 0.0, sizes, 1.0)


def interpolated(times: FloatArray, values: FloatArray) -> Inputs:
    """Return the inputs (N, U) measured at `times` (N,) as a function of time: cubic between them, constant beyond."""
    from scipy.interpolate import PchipInterpolator

    if len(times) < 2:
        constant = values[0].copy()
        return lambda _: constant
    curve = PchipInterpolator(times, values, axis=0)
    first, last = float(times[0]), float(times[-1])
    return lambda t: np.asarray(curve(min(max(t, first), last)))


def together(parts: Sequence[Callable[[float], float]]) -> Inputs:
    """Return the inputs, one function of time for each."""
    return lambda t: np.array([part(t) for part in parts], dtype=np.float64)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
