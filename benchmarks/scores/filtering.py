"""The likelihood of a filter: its noise is estimated once, along the system that describes the data best, and held."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal

import numpy as np
from scipy.optimize import least_squares, minimize

from atoll_coordinator.model.criteria import constant_nats_of, structure_length
from atoll_coordinator.model.shooting.kernels.integrate import PRECISE
from atoll_coordinator.model.shooting.measurements import Measurements
from atoll_coordinator.model.shooting.multiple_shooting import row_steps
from atoll_coordinator.model.shooting.system import System, system_of
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import Program
from benchmarks.scores.evidence import occam
from benchmarks.scores.kernels.kalman import Layout, Noise, filter_rows
from benchmarks.scores.pools import Pool, Scored, nothing

STEPS_PER_ROW: Final = 200
FINEST: Final = 1e-9
TOLERATED: Final = 1e-3
"""Error of a step over a state's standard deviation: at least the former, or this share of the noise."""
UNKNOWN: Final = 10.0
"""Standard deviation of an initial state before the first row, over the state's."""
LOST: Final = 1e3
"""Innovations, over their deviations, of a system that could not be filtered."""
FITTED: Final = 15
ROUNDS: Final = 2
"""How often gains are taken anew from a system that was fitted with the former ones."""
TRIED: Final = 2
"""Systems for which noise is estimated; the best of them is the reference."""
_LOWEST: Final = -56.0
_HIGHEST: Final = 5.0
_STEEPEST: Final = 7.0
_CHANCE: Final = 1.96
_DECAY: Final = 0.7

NoiseParts = frozenset[Literal["process", "drift"]]
NOISES: Final[tuple[NoiseParts, ...]] = (frozenset(), frozenset(("process",)), frozenset(("drift",)))
"""What there may be beside independent errors of sensors."""


@dataclass(frozen=True, eq=False)
class Filtered:
    """What filtering gave: innovations (O, N), variances (O, N), gains (N, O, A), gradients (N, O, P)."""

    innovations: FloatArray
    variances: FloatArray
    gains: FloatArray
    gradients: FloatArray
    is_whole: bool


class Filter:
    """Filters systems along the rows of `measurements`; `is_counted` (O, N) are numbers that a likelihood has."""

    def __init__(self, measurements: Measurements, names: Sequence[str]) -> None:
        self.measurements = measurements
        self.names = tuple(names)
        bounds, times = measurements.bounds, measurements.times
        inner = np.ones(measurements.rows, dtype=bool)
        inner[bounds[:, 0]] = False
        self.width = float(np.median(np.diff(times, prepend=times[0])[inner]))
        measured = np.where(measurements.weights > 0.0, measurements.measured, 0.0)
        self._layout: Layout = (bounds, row_steps(measurements), measured, measurements.weights, measurements.observed)
        self._starts = np.ascontiguousarray(measurements.smoothed[:, bounds[:, 0]].T)
        tolerance = max(FINEST, TOLERATED * float(measurements.relative_noise.min()))
        self._tolerance = tolerance * measurements.scales
        self.is_counted = (measurements.weights > 0.0) & inner[None]

    def system(self, programs: Sequence[Program]) -> System:
        """Return the system of some programs."""
        return system_of(programs, self.names, self.measurements.variables)

    def run(self, system: System, noise: Noise, held: Filtered | None = None) -> Filtered:
        """Filter a system with gains by `noise`, or with those that are `held`."""
        measurements = self.measurements
        states, sensors, rows = len(system.outputs), len(measurements.observed), measurements.rows
        innovations, gradients = np.zeros((sensors, rows)), np.zeros((rows, sensors, system.count))
        gains = np.zeros((rows, sensors, states + sensors)) if held is None else held.gains
        variances = np.ones((sensors, rows)) if held is None else held.variances
        done = filter_rows(
            PRECISE, system.tape, system.owners, (measurements.times, measurements.inputs, measurements.input_slopes),
            self._layout, self._starts, (UNKNOWN * measurements.scales) ** 2, self._tolerance,
            measurements.limits, STEPS_PER_ROW * rows, noise, held is not None, gains, variances,
            innovations, gradients,
        )  # fmt: skip
        is_whole = done == len(measurements.bounds) and bool(np.isfinite(innovations).all())
        return Filtered(innovations, variances, gains, gradients, is_whole)

    def nats(self, filtered: Filtered, times: FloatArray | None = None) -> float:
        """Return minus the log-likelihood, without what the number of rows adds; rows count `times` (O,) each."""
        if not filtered.is_whole:
            return math.inf
        total = np.log(filtered.variances) + filtered.innovations**2 / filtered.variances
        by_sensor = 0.5 * np.where(self.is_counted, total, 0.0).sum(axis=1)
        return float(by_sensor.sum() if times is None else by_sensor @ times)

    def information(self, filtered: Filtered, times: FloatArray) -> FloatArray:
        """Return Gauss's and Newton's second derivatives (P, P) of the nats by the constants, gains and variances held.

        Rows count `times` (O,) each.
        """
        weights = np.where(self.is_counted, times[:, None] / filtered.variances, 0.0).T
        slopes = filtered.gradients
        return np.asarray(np.einsum("no,nop,noq->pq", weights, slopes, slopes, optimize=True))

    def independent_share(self, filtered: Filtered) -> FloatArray:
        """Return the independent rows over all rows (O,) by the correlations r of the innovations along trajectories.

        That is 1/(1 + 2 (|r1| + |r2| + ...)), taken in by pairs as long as one of a pair is not chance (Bartlett 1946,
        1.96 over the root of the rows, which about one in twelve pairs of white errors exceeds). Sizes, since errors of
        a solver swing from row to row in step with its steps and are none the more independent for that.
        """
        scaled = np.where(self.is_counted, filtered.innovations / np.sqrt(filtered.variances), 0.0)
        shares = np.ones(len(scaled))
        for sensor, values in enumerate(scaled):
            parts = [values[first:end] for first, end in self.measurements.bounds.tolist()]
            longest = max(map(len, parts))
            sums = [
                sum(float(part[lag:] @ part[: len(part) - lag]) for part in parts if len(part) > lag)
                for lag in range(longest)
            ]
            sizes = np.abs(np.array(sums[1 : 2 * ((longest - 1) // 2) + 1]) / max(sums[0], 1e-300)).reshape(-1, 2)
            is_chance = (sizes < _CHANCE / math.sqrt(float(self.is_counted[sensor].sum()))).all(axis=1)
            end = int(np.argmax(is_chance)) if is_chance.any() else len(sizes)
            shares[sensor] = 1.0 / (1.0 + 2.0 * float(sizes[:end].sum()))
        return shares

    def fit(self, system: System, noise: Noise, held: Filtered) -> System:
        """Return the system with the constants of greatest likelihood, gains held."""
        weights = (self.is_counted / np.sqrt(held.variances)).ravel()
        last: dict[bytes, Filtered] = {}

        def run(values: FloatArray) -> Filtered:
            key = values.tobytes()
            if key not in last:
                last.clear()
                last[key] = self.run(system.with_values(values), noise, held)
            return last[key]

        def residuals(values: FloatArray) -> FloatArray:
            filtered = run(values)
            if not filtered.is_whole:
                return LOST * np.sign(weights)
            return np.clip(filtered.innovations.ravel() * weights, -1e150, 1e150)

        def jacobian(values: FloatArray) -> FloatArray:
            slopes = np.moveaxis(run(values).gradients, 0, 1).reshape(len(weights), system.count)
            return np.nan_to_num(slopes * weights[:, None], posinf=0.0, neginf=0.0)

        if not system.count:
            return system
        with np.errstate(all="ignore"):
            begun = residuals(system.values)
            if not np.isfinite(begun).all():
                return system
            solved = least_squares(
                residuals,
                system.values,
                jacobian,
                method="lm",
                x_scale="jac",
                max_nfev=FITTED,
                xtol=1e-7,
                ftol=1e-7,
            )
        return system.with_values(solved.x)

    def guess(self) -> Noise:
        """Return the noise to begin with: the smoother's at the sensors, and a little in the states."""
        measurements = self.measurements
        scales = measurements.scales
        sensor = np.maximum(measurements.noise, 1e-6 * scales[measurements.observed]) ** 2
        process = (1e-3 * scales) ** 2 / self.width
        return process, sensor, np.zeros(len(sensor)), np.full(len(sensor), _DECAY)

    def estimate(self, system: System, noise: Noise, parts: NoiseParts) -> tuple[Noise, float]:
        """Return the noise of greatest likelihood along a system, its constants fixed, and its nats.

        There is noise in the states, or drift, only where it is among the `parts`.
        """
        fixed, measurements = system.with_fixed_constants(), self.measurements
        states, sensors = len(measurements.scales), len(measurements.observed)
        own, seen = measurements.scales**2 / self.width, measurements.scales[measurements.observed] ** 2
        has_process, has_drift = "process" in parts, "drift" in parts

        def noise_of(numbers: FloatArray) -> Noise:
            sensor = (SETTINGS.shooting.exact**2 + np.exp(np.minimum(numbers[:sensors], _HIGHEST))) * seen
            rest = numbers[sensors:]
            process, drift, decay = np.zeros(states), np.zeros(sensors), np.full(sensors, _DECAY)
            if has_process:
                process, rest = np.exp(np.clip(rest[:states], _LOWEST, _HIGHEST)) * own, rest[states:]
            if has_drift:
                drift = np.exp(np.clip(rest[:sensors], _LOWEST, _HIGHEST)) * seen
                decay = 1.0 / (1.0 + np.exp(-np.clip(rest[sensors:], -_STEEPEST, _STEEPEST)))
            return process, sensor, drift, decay

        def nats(numbers: FloatArray) -> float:
            value = self.nats(self.run(fixed, noise_of(numbers)))
            return value if math.isfinite(value) else 1e12

        known = np.log(np.maximum(noise[1] / seen, 1e-24))
        starts = [known, known - 8.0] if has_process else [known]
        if has_process:
            sizes = (np.log(np.maximum(noise[0] / own, 1e-24)), np.full(states, -4.0 + known.mean()))
            starts = [np.concatenate([start, size]) for start in starts for size in sizes]
        if has_drift:
            ratio = np.full(sensors, math.log(_DECAY / (1.0 - _DECAY)))
            starts = [np.concatenate([start, known - 0.7, ratio]) for start in starts]
        begun = min(starts, key=nats)
        with np.errstate(all="ignore"):
            solved = minimize(nats, begun, method="L-BFGS-B", options={"maxiter": 12, "eps": 1e-3})
        best = solved.x if solved.fun < nats(begun) else begun
        return noise_of(best), nats(best)


@dataclass(frozen=True, eq=False)
class Reference:
    """A system with the noise of greatest likelihood along it, and the nats of both, 1/2 ln N for each variance."""

    place: int
    system: System
    noise: Noise
    nats: float


@dataclass(frozen=True, eq=False)
class Compared:
    """The systems of a pool fitted with the noise of a reference, nats of their structures, numbers of constants."""

    filter: Filter
    reference: Reference
    fitted: Sequence[System]
    structures: FloatArray
    counts: FloatArray


@lru_cache(maxsize=1)
def compared(pool: Pool) -> Compared | None:
    """Return the systems fitted with the noise of the one that describes the data best, however long it is.

    Were it chosen by its length, a system that leaves something out would come with noise of its own that hides it.
    None where nothing can be filtered.
    """
    filter_ = Filter(pool.task.compared_measurements, pool.task.dataset.names)
    systems = [filter_.system(programs) for programs in pool.systems]
    counts = np.array([float(system.count) for system in systems])
    structures = np.array([sum(map(structure_length, programs)) for programs in pool.systems])
    fitted, nats = fit_all(filter_, systems, filter_.guess())
    order = [place for place in np.argsort(nats + counts, kind="stable").tolist() if math.isfinite(nats[place])]
    if not order:
        return None
    tried = [refer(filter_, place, fitted[place]) for place in order[:TRIED]]
    reference = min(tried, key=lambda one: one.nats + counts[one.place])
    fitted, nats = fit_all(filter_, fitted, reference.noise)
    best = int(np.argmin(nats + counts))
    if all(best != one.place for one in tried):
        other = refer(filter_, best, fitted[best])
        if other.nats + counts[best] < reference.nats + counts[reference.place]:
            reference = other
            fitted, nats = fit_all(filter_, fitted, reference.noise)
    return Compared(filter_, reference, fitted, structures, counts)


Prices = Literal["schwarz", "laplace"]


def by_filter(pool: Pool) -> Scored:
    """Return the nats of the systems by the likelihood of a filter, its noise that of the best description."""
    return _scored(pool, "schwarz", is_tempered=False)


def by_tempered_filter(pool: Pool) -> Scored:
    """Return the same where rows count as many times as the innovations of the reference are independent.

    Errors of a solver are a function of the state: the innovations of a right law go together, and all likelihoods that
    take them for independent describe them. A power of the likelihood does not (Miller & Dunson 2019, Journal of the
    American Statistical Association 114:1113).
    """
    return _scored(pool, "schwarz", is_tempered=True)


def by_evidence(pool: Pool) -> Scored:
    """Return the same with the evidence of the constants, see `evidence.occam`, in the place of 1/2 ln N for each."""
    return _scored(pool, "laplace", is_tempered=True)


def _scored(pool: Pool, prices: Prices, *, is_tempered: bool) -> Scored:
    done = compared(pool)
    if done is None:
        return nothing(pool)
    filter_, noise = done.filter, done.reference.noise
    times = np.ones(len(noise[1]))
    if is_tempered:
        times = filter_.independent_share(filter_.run(done.reference.system, noise))
    filtered = [filter_.run(system, noise) for system in done.fitted]
    misfits = np.array([filter_.nats(one, times) for one in filtered])
    nats = misfits + done.structures
    if prices == "schwarz":
        nats += constant_nats_of(filter_.measurements.rows * float(times.mean())) * done.counts
    else:
        inputs = pool.task.dataset.inputs
        nats += [
            occam(filter_.information(one, times), system, inputs) if one.is_whole else math.inf
            for one, system in zip(filtered, done.fitted, strict=True)
        ]
    note = (
        f"reference {pool.kinds[done.reference.place]}, noise {np.concatenate(noise).tolist()}, times {times.tolist()}"
    )
    errors = errors_of(filter_.information(filtered[0], times)) if filtered[0].is_whole else ()
    estimates = tuple(done.fitted[0].values.tolist()) if errors else ()
    return Scored(tuple(nats.tolist()), tuple(misfits.tolist()), estimates, errors, note)


def errors_of(information: FloatArray) -> tuple[float, ...]:
    """Return standard errors (P,) by second derivatives (P, P) of minus the log-likelihood; none where these are none.

    Those of constants that nothing determines are 0, and count as no interval.
    """
    if not np.isfinite(information).all():
        return ()
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    covariance = np.linalg.pinv(information / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
    return tuple(np.sqrt(np.maximum(np.diag(covariance), 0.0)).tolist())


def fit_all(filter_: Filter, systems: Sequence[System], noise: Noise) -> tuple[list[System], FloatArray]:
    """Return the systems fitted with this noise, each with gains of its own, and their nats."""
    fitted = [fit_own(filter_, system, noise) for system in systems]
    return fitted, np.array([filter_.nats(filter_.run(system, noise)) for system in fitted])


def fit_own(filter_: Filter, system: System, noise: Noise) -> System:
    """Return a system fitted with the gains that it has itself."""
    for _ in range(ROUNDS):
        held = filter_.run(system, noise)
        if not held.is_whole:
            break
        system = filter_.fit(system, noise, held)
    return system


def refer(filter_: Filter, place: int, system: System) -> Reference:
    """Return a system with the noise that describes it in the fewest nats."""
    references = [_with_noise(filter_, place, system, parts) for parts in NOISES]
    return min(references, key=lambda one: one.nats)


def _with_noise(filter_: Filter, place: int, system: System, parts: NoiseParts) -> Reference:
    noise, _ = filter_.estimate(system, filter_.guess(), parts)
    system = filter_.fit(system, noise, filter_.run(system, noise))
    noise, nats = filter_.estimate(system, noise, parts)
    measurements = filter_.measurements
    sensors = len(measurements.observed)
    numbers = ("process" in parts) * len(measurements.scales) + 2 * ("drift" in parts) * sensors
    return Reference(place, system, noise, nats + constant_nats_of(measurements.rows) * numbers)
