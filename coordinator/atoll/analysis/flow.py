"""A vector field with its inputs and parameters held, followed in time. Letters: D states, N starts.

One start is followed by LSODA, which copes with stiffness (Petzold 1983); many starts at once by the pair of Dormand
and Prince (1980) of order 5, each start with steps of its own. Both are bounded in steps, and a run that leaves every
bound or meets a point without a value ends there: that is a result, not an error.
"""

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll.model.vector_field import VectorField
from atoll_core.data.dataset import FloatArray

Rates = Callable[[FloatArray], FloatArray]

MOST_STEPS: Final = 20_000
"""Steps of one start."""

SETTLING: Final = 60.0
"""Length of simulations, in times that a state takes through the box: what decays ten times as slowly as that is by
then down to exp(-6), a quarter of a percent."""

UNBOUNDED: Final = 1e3
"""Widths of the box from its middle beyond which a state counts as gone."""

_NODES: Final = (
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
    (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)
_ERROR: Final = (71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40)


@dataclass(frozen=True, eq=False)
class Flow:
    """dx/dt = f(x) of D states: a `field` at `inputs` (U,) and `parameters` (P,), `direction` -1 for backward time."""

    field: VectorField
    inputs: FloatArray
    parameters: FloatArray
    direction: float = 1.0

    @classmethod
    def of(cls, field: VectorField, inputs: FloatArray | None = None) -> "Flow":
        """Return the flow at the parameters of the model; inputs are 0 unless given."""
        held = np.zeros(len(field.inputs)) if inputs is None else np.asarray(inputs, dtype=np.float64)
        return cls(field, held, field.values_of_parameters)

    @property
    def size(self) -> int:
        """The number of states D."""
        return len(self.field.states)

    def rates(self, x: FloatArray) -> FloatArray:
        """Return dx/dt at (D,) or (N, D)."""
        return self.direction * self.field.values(x, self.inputs, self.parameters)

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Return the Jacobian (D, D) or (N, D, D)."""
        return self.direction * self.field.jacobian(x, self.inputs, self.parameters)

    def by_parameters(self, x: FloatArray) -> FloatArray:
        """Return the derivative of dx/dt by the parameters, (D, P) or (N, D, P)."""
        return self.direction * self.field.parameter_derivatives(x, self.inputs, self.parameters)

    def by_inputs(self, x: FloatArray) -> FloatArray:
        """Return the derivative of dx/dt by the inputs, (D, U) or (N, D, U)."""
        return self.direction * self.field.input_derivatives(x, self.inputs, self.parameters)


@dataclass(frozen=True, eq=False)
class Step:
    """A step of one start: from `before` to `after`; `at(time)` is the state between, (D,)."""

    before: float
    after: float
    start: FloatArray
    end: FloatArray
    at: Callable[[float], FloatArray]


def steps(
    rates: Rates, start: FloatArray, duration: float, sizes: FloatArray, *, rtol: float = 1e-9, most: int = MOST_STEPS
) -> Iterator[Step]:
    """Yield the steps from `start` over `duration`; fewer where a state has no rates or `most` are done.

    Errors are `rtol` of a state, and a hundredth of that of its size (D,), such as its extent in a box.
    """
    from scipy.integrate import LSODA

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if not np.isfinite(rates(start)).all():
            return
        solver = LSODA(lambda _, x: rates(x), 0.0, start, duration, rtol=rtol, atol=0.01 * rtol * sizes)
        for _ in range(most):
            before, state = float(solver.t), solver.y.copy()
            solver.step()
            if solver.status == "failed" or not np.isfinite(solver.y).all() or solver.t <= before:
                return
            yield Step(before, float(solver.t), state, solver.y.copy(), solver.dense_output())
            if solver.status == "finished":
                return


def crossing(step: Step, side: Callable[[FloatArray], float]) -> float:
    """Return the time within a step at which the sign of `side` changes, which is a function of the state (D,)."""
    from scipy.optimize import brentq

    def at(share: float) -> float:  # of the step: digits of a time have its unit
        return side(step.at(step.before + share * (step.after - step.before)))

    low, high = at(0.0), at(1.0)
    is_between = min(low, high) < 0.0 < max(low, high)
    share = float(brentq(at, 0.0, 1.0)) if is_between else float(abs(high) < abs(low))
    return step.before + share * (step.after - step.before)


def follow(rates: Rates, start: FloatArray, times: FloatArray, sizes: FloatArray) -> FloatArray:
    """Return the states (n, D) at rising `times` from 0; NaN after the point where the course cannot be followed.

    `sizes` (D,) are those of the states, as of `steps`.
    """
    states = np.full((len(times), len(start)), np.nan)
    row = 0
    while row < len(times) and times[row] <= 0.0:
        states[row] = start
        row += 1
    for step in steps(rates, start, float(times[-1]) if len(times) else 0.0, sizes):
        while row < len(times) and times[row] <= step.after:
            states[row] = step.at(float(times[row]))
            row += 1
    return states


@dataclass(eq=False)
class IntegrationBatch:
    """N starts that are integrated together: `states` (N, D), each at its time (N,) with its next step (N,).

    `is_lost` (N,): it met a point without rates.
    """

    states: FloatArray
    times: FloatArray
    sizes: FloatArray
    is_lost: np.ndarray

    @classmethod
    def of(cls, states: FloatArray, step: float) -> "IntegrationBatch":
        """Return starts at time 0, with a first step to try."""
        count = len(states)
        return cls(np.array(states), np.zeros(count), np.full(count, step), np.zeros(count, dtype=bool))

    def of_rows(self, rows: np.ndarray) -> "IntegrationBatch":
        """Return some of the starts."""
        return IntegrationBatch(self.states[rows], self.times[rows], self.sizes[rows], self.is_lost[rows])

    def advance(self, rates: Rates, until: float, scale: FloatArray, *, rtol: float, most_steps: int = 1000) -> None:
        """Follow every start that is not lost until that time, with errors of `rtol` of `scale` (D,) and its values.

        Starts that take more than `most_steps` for it stay behind.
        """
        tiny = 1e-12 * until
        for _ in range(most_steps):
            rows = np.flatnonzero(~self.is_lost & (self.times < until - tiny))
            if not len(rows):
                return
            self._step(rates, rows, until, rtol, scale)

    def _step(self, rates: Rates, rows: np.ndarray, until: float, rtol: float, scale: FloatArray) -> None:
        state, size = self.states[rows], np.minimum(self.sizes[rows], until - self.times[rows])
        is_cut = size < self.sizes[rows]
        slopes = [rates(state)]
        with np.errstate(all="ignore"):
            for weights in _NODES:
                moved = sum(weight * slope for weight, slope in zip(weights, slopes, strict=True) if weight)
                after = state + size[:, None] * moved
                slopes.append(rates(after))
            wrong = size[:, None] * sum(weight * slope for weight, slope in zip(_ERROR, slopes, strict=True) if weight)
            allowed = rtol * (scale + np.maximum(np.abs(state), np.abs(after)))
            error = np.sqrt(np.mean((wrong / allowed) ** 2, axis=1))
            error = np.where(np.isfinite(error), error, 1e10)
            factor = np.clip(0.9 * np.maximum(error, 1e-10) ** -0.2, 0.2, 5.0)
        good = error <= 1.0
        self.states[rows[good]] = after[good]
        self.times[rows[good]] += size[good]
        proposed = size * factor
        self.sizes[rows] = np.where(good & is_cut, np.maximum(self.sizes[rows], proposed), proposed)
        self.is_lost[rows] |= self.sizes[rows] < 1e-13 * until
