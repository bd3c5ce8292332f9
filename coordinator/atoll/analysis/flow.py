"""A vector field at constant inputs and parameters, the box of states to analyse, and integration in time.

One initial state is integrated by LSODA, which handles stiffness (Petzold 1983). Many initial states are integrated
together by the pair of Dormand and Prince (1980) of order 5; each state has its own step. If stability and not accuracy
limits the step of a state, this state continues with a Rosenbrock method (RODAS3 of Sandu et al. 1997, Atmospheric
Environment 31:3459: order 3, four stages, L-stable). SciPy has no integrator for many initial states with separate
steps; LSODA for each of 1,600 grid points would take a hundred times as long.

All integrations have a limited number of steps. A trajectory ends early if it diverges or if a rate is undefined. This
is a result and not an error. Doubtful: stiffness is detected by a heuristic (Hairer and Wanner 1996, section IV.2), and
a slow transient can be longer than the integration. Letters: D states, N initial states.
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
"""Largest number of steps of one LSODA integration."""

SETTLING: Final = 60.0
"""Length of simulations, in units of the time in which a state crosses the box. A transient with ten times this time
constant has then decayed to exp(-6), a quarter of a percent."""

EXTENSIONS: Final = (1e2, 1e4, 1e6)
"""Factors that extend the duration for states that are nearly at rest, because they move in a slow direction."""

_REST_DISTANCE: Final = 0.02
"""A state is nearly at rest when it moves less than this number of box widths within the time needed to cross
the box."""

UNBOUNDED: Final = 1e3
"""Distance from the middle of the box, in widths, beyond which a state counts as diverged."""

_NODES: Final = (
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
    (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)
_ERROR: Final = (71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40)

_UNSTABLE: Final = 3.25
"""Product of step and largest eigenvalue at the stability boundary (Hairer and Wanner 1996, section IV.2)."""

_STIFF_STEPS: Final = 15
"""Number of steps at the stability boundary after which an initial state counts as stiff (ibid.)."""

_CALM_STEPS: Final = 6
"""Number of consecutive other steps that reset the count of `_STIFF_STEPS` (ibid.)."""


@dataclass(frozen=True, eq=False)
class Box:
    """Lower and upper bounds of D states, both (D,), lower < upper."""

    lower: FloatArray
    upper: FloatArray

    @property
    def widths(self) -> FloatArray:
        """The widths (D,)."""
        return self.upper - self.lower

    @property
    def middle(self) -> FloatArray:
        """The middle (D,)."""
        return 0.5 * (self.lower + self.upper)

    def points(self, count: int, seed: int = 0) -> FloatArray:
        """Return `count` points (count, D) spread evenly over the box: an additive recurrence (Roberts 2018).

        Its ratios are powers of the root of g**(D + 1) = g + 1; each `seed` gives different points.
        """
        size, root = len(self.lower), 1.5
        for _ in range(64):
            root = (1.0 + root) ** (1.0 / (size + 1))
        ratios = root ** -np.arange(1.0, size + 1)
        numbers = np.arange(1.0, count + 1) + seed * count
        return np.asarray(self.lower + self.widths * ((0.5 + numbers[:, None] * ratios) % 1.0))

    def excursions(self, states: FloatArray) -> FloatArray:
        """Return for states (N, D) the largest coordinate distance (N,) from the middle, in widths of the box."""
        return np.asarray((np.abs(states - self.middle) / self.widths).max(axis=1))

    def contains(self, points: FloatArray, margin: float = 0.0) -> np.ndarray:
        """Tell which points (N, D) lie in the box, widened on each side by `margin` widths."""
        beyond = margin * self.widths
        return np.asarray(((points >= self.lower - beyond) & (points <= self.upper + beyond)).all(axis=-1))

    def distances(self, points: FloatArray, polyline: FloatArray) -> FloatArray:
        """Return the distances (N,) of points (N, D) from the sides of a polyline (n, D), in widths of the box."""
        corners = polyline / self.widths
        sides, away = np.diff(corners, axis=0), points[:, None] / self.widths - corners[:-1]
        lengths = np.maximum((sides**2).sum(axis=1), 1e-300)
        share = np.clip((away * sides).sum(axis=2) / lengths, 0.0, 1.0)
        return np.asarray(np.sqrt(((away - share[:, :, None] * sides) ** 2).sum(axis=2)).min(axis=1))


@dataclass(frozen=True, eq=False)
class Flow:
    """dx/dt = f(x) of D states: a `field` at constant `inputs` (U,) and `parameters` (P,).

    `direction` is 1, or -1 for backward time.
    """

    field: VectorField
    inputs: FloatArray
    parameters: FloatArray
    direction: float = 1.0

    @classmethod
    def of(cls, field: VectorField, inputs: FloatArray | None = None) -> "Flow":
        """Return the flow at the parameters of the model; inputs are 0 by default."""
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


# ------------------------------------------------------------------------------------------------- one initial state


@dataclass(frozen=True, eq=False)
class Step:
    """One step from time `before` to `after`; `start` and `end` are its states (D,), `at(time)` interpolates them."""

    before: float
    after: float
    start: FloatArray
    end: FloatArray
    at: Callable[[float], FloatArray]


def steps(
    rates: Rates, start: FloatArray, duration: float, sizes: FloatArray, *, rtol: float = 1e-9, most: int = MOST_STEPS
) -> Iterator[Step]:
    """Yield the steps from `start` (D,) over `duration`; they end early if a rate is undefined or after `most` steps.

    The relative tolerance is `rtol`; the absolute tolerance is 0.01 `rtol` times the `sizes` (D,) of the states.
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
    """Return the time within a step at which `side`, a function of the state (D,), changes its sign."""
    from scipy.optimize import brentq

    def at(share: float) -> float:  # time as a share of the step, because the tolerance of brentq is absolute
        return side(step.at(step.before + share * (step.after - step.before)))

    low, high = at(0.0), at(1.0)
    is_between = min(low, high) < 0.0 < max(low, high)
    share = float(brentq(at, 0.0, 1.0)) if is_between else float(abs(high) < abs(low))
    return step.before + share * (step.after - step.before)


def follow(rates: Rates, start: FloatArray, times: FloatArray, sizes: FloatArray) -> FloatArray:
    """Return the states (n, D) at ascending `times` (n,) from 0; NaN after the integration has ended.

    `sizes` (D,) are the sizes of the states, as in `steps`.
    """
    states = np.full((len(times), len(start)), np.nan)
    row = int(np.searchsorted(times, 0.0, side="right"))
    states[:row] = start
    for step in steps(rates, start, float(times[-1]) if len(times) else 0.0, sizes):
        while row < len(times) and times[row] <= step.after:
            states[row] = step.at(float(times[row]))
            row += 1
    return states


# ----------------------------------------------------------------------------------------------- many initial states


def is_nearly_at_rest(states: FloatArray, before: FloatArray, box: Box, span: float) -> np.ndarray:
    """Tell which `states` (N, D) have hardly moved since `before` (N, D).

    `span` is the elapsed time, in units of the time in which a state crosses the box.
    """
    return np.asarray(np.abs((states - before) / box.widths).max(axis=1) < _REST_DISTANCE * span)


@dataclass(eq=False)
class IntegrationBatch:
    """N `states` (N, D) that are integrated together; `times` (N,) are their times, `sizes` (N,) their next steps.

    `is_lost` (N,): a rate became undefined. `bounded` (N,) counts the steps at the stability boundary, `calm` (N,) the
    other steps since the last step at the boundary. Stiff states continue with implicit steps.
    """

    states: FloatArray
    times: FloatArray
    sizes: FloatArray
    is_lost: np.ndarray
    bounded: np.ndarray
    calm: np.ndarray

    @classmethod
    def of(cls, states: FloatArray, step: float) -> "IntegrationBatch":
        """Return a batch of `states` (N, D) at time 0 that tries `step` as first step."""
        count = len(states)
        counters = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
        return cls(np.array(states), np.zeros(count), np.full(count, step), np.zeros(count, dtype=bool), *counters)

    def of_rows(self, rows: np.ndarray) -> "IntegrationBatch":
        """Return a batch of some of the states: an index array or a mask (N,)."""
        parts = (self.states, self.times, self.sizes, self.is_lost, self.bounded, self.calm)
        return IntegrationBatch(*(part[rows] for part in parts))

    def settle(self, flow: Flow, box: Box, until: float, *, rtol: float, most_steps: int) -> None:
        """Integrate a flow until the time `until`; absolute tolerances are `rtol` times a thousandth of the box."""
        self.advance(flow.rates, until, 1e-3 * box.widths, rtol=rtol, most_steps=most_steps, jacobian=flow.jacobian)

    def advance(
        self,
        rates: Rates,
        until: float,
        scale: FloatArray,
        *,
        rtol: float,
        most_steps: int = 1000,
        jacobian: Rates | None = None,
    ) -> None:
        """Integrate every state that is not lost until the time `until`.

        The tolerance is `rtol` times the sum of `scale` (D,) and the absolute state. A state that needs more than
        `most_steps` steps stays at an earlier time. Without a `jacobian` all steps are explicit.
        """
        tiny = 1e-12 * until
        for _ in range(most_steps):
            is_waiting = ~self.is_lost & (self.times < until - tiny)
            if not is_waiting.any():
                return
            is_implicit = (self.bounded >= _STIFF_STEPS) & (jacobian is not None)
            explicit, implicit = np.flatnonzero(is_waiting & ~is_implicit), np.flatnonzero(is_waiting & is_implicit)
            if len(explicit):
                self._step(rates, explicit, until, rtol, scale)
            if len(implicit) and jacobian is not None:
                self._implicit_step(rates, jacobian, implicit, until, rtol, scale)

    def _step(self, rates: Rates, rows: np.ndarray, until: float, rtol: float, scale: FloatArray) -> None:
        state, size = self.states[rows], np.minimum(self.sizes[rows], until - self.times[rows])
        slopes, after = [rates(state)], state
        with np.errstate(all="ignore"):
            for weights in _NODES:
                before = after
                moved = sum(weight * slope for weight, slope in zip(weights, slopes, strict=True) if weight)
                after = state + size[:, None] * moved
                slopes.append(rates(after))
            wrong = size[:, None] * sum(weight * slope for weight, slope in zip(_ERROR, slopes, strict=True) if weight)
            allowed = rtol * (scale + np.maximum(np.abs(state), np.abs(after)))
            # the difference of the last two stages is along the fastest direction: it estimates the largest eigenvalue
            turned, moved = (((both[0] - both[1]) / allowed) ** 2 for both in (slopes[-1:-3:-1], (after, before)))
            eigenvalue = np.sqrt(turned.sum(axis=1) / np.maximum(moved.sum(axis=1), 1e-300))
            is_bounded = size * eigenvalue > _UNSTABLE
        good = self._accept(rows, size, until, after, wrong / allowed, 0.2)
        is_counted = good & (self.bounded[rows] < _STIFF_STEPS)
        self.bounded[rows[is_counted & is_bounded]] += 1
        self.calm[rows[is_counted]] = np.where(is_bounded, 0, self.calm[rows] + 1)[is_counted]
        self.bounded[rows[is_counted & (self.calm[rows] >= _CALM_STEPS)]] = 0

    def _implicit_step(
        self, rates: Rates, jacobian: Rates, rows: np.ndarray, until: float, rtol: float, scale: FloatArray
    ) -> None:
        state, size = self.states[rows], np.minimum(self.sizes[rows], until - self.times[rows])
        slopes = jacobian(state)
        slopes = np.where(np.isfinite(slopes), slopes, 0.0)
        with np.errstate(all="ignore"):
            inverse = np.linalg.inv((2.0 / size)[:, None, None] * np.eye(state.shape[1]) - slopes)

            def solve(right: FloatArray) -> FloatArray:
                return np.asarray((inverse @ right[:, :, None])[:, :, 0])

            per_step, rate = 1.0 / size[:, None], rates(state)
            first = solve(rate)
            second = solve(rate + 4.0 * per_step * first)
            third = solve(rates(state + 2.0 * first) + per_step * (first - second))
            after = state + 2.0 * first + third
            fourth = solve(rates(after) + per_step * (first - second - 8.0 / 3.0 * third))
            after = after + fourth
            allowed = rtol * (scale + np.maximum(np.abs(state), np.abs(after)))
        self._accept(rows, size, until, after, fourth / allowed, 1.0 / 3.0)

    def _accept(
        self, rows: np.ndarray, size: FloatArray, until: float, after: FloatArray, wrong: FloatArray, power: float
    ) -> np.ndarray:
        """Accept the steps with small errors; return which these are (N,). `wrong` (N, D): error over tolerance."""
        with np.errstate(all="ignore"):
            error = np.sqrt(np.mean(wrong**2, axis=1))
            error = np.where(np.isfinite(error), error, 1e10)
            factor = np.clip(0.9 * np.maximum(error, 1e-10) ** -power, 0.2, 5.0)
        good, is_last, proposed = error <= 1.0, size < self.sizes[rows], size * factor
        self.states[rows[good]] = after[good]
        self.times[rows[good]] += size[good]
        self.sizes[rows] = np.where(good & is_last, np.maximum(self.sizes[rows], proposed), proposed)
        self.is_lost[rows] |= self.sizes[rows] < 1e-13 * until
        return np.asarray(good)
