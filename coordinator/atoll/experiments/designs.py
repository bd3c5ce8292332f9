"""Possible experiments, the predictions of each candidate for them, and the expected gain from their outcomes.

An experiment is one trajectory from an initial state, measured at given times with the measurement errors of the data.
The prediction of a candidate is its simulation. To first order it has a Gaussian distribution, which comes from the
errors of the constants. The initial state is fitted too. Therefore a difference between two predictions has no value if
a shift of the initial state within its bounds explains it.

Let d be the difference between the predictions of two candidates i and j, in standard errors of the measurements, and S
their covariances. The discrepancy is d' (S_i + S_j)^-1 d (Buzzi-Ferraris & Forzatti 1983, Chem. Eng. Sci. 38:225). A
quarter of it is the Bhattacharyya distance B_ij. The expected information about the right candidate, in nats, is at
least -sum_i w_i ln sum_j w_j exp(-B_ij) (Kolchinsky & Tracey 2017, Entropy 19:361), and at most the entropy of the
weights w. The expected evidence for the right candidate is sum_i w_i sum_j w_j/(1 - w_i) 4 B_ij nats. For equal
covariances this is the formula of Box and Hill (1967); the formula of Hunter & Reiner (1965) ignores the errors of the
constants. Experiments are ranked by this evidence, limited for each pair of candidates to the amount that decides.

The best experiments are examined without the first-order approximation. The prediction of candidate i is added to the
data, and candidate j is fitted to all data. The increase in deviance of j is 8 B_ij.

The expected information about the constants of one candidate is 1/2 ln det(1 + C F), with their covariance C and the
Fisher information F of the experiment (Lindley 1956; D-optimality).

Doubtful: far from the data, first-order errors are unreliable, and so are the candidates. Letters: D states, U inputs,
P constants, O measured states, n rows.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, get_args

import numpy as np

from atoll.analysis.flow import Box
from atoll.experiments.fits import EquationSetFit, FitData, eigenaxes
from atoll_coordinator.model.shooting.integration import STEPS_PER_ROW
from atoll_coordinator.model.shooting.kernels.implicit import STIFF
from atoll_coordinator.model.shooting.kernels.integrate import PRECISE, integrate_segments
from atoll_coordinator.model.shooting.measurements import BLOW_UP_WIDTHS, TrajectoryMeasurements
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.result.result import Result
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError

Cost = Literal["trajectory", "duration", "samples"]
"""The cost of an experiment: 1, its duration, or its number of samples."""
COSTS: Final[tuple[str, ...]] = get_args(Cost)


@dataclass(frozen=True, eq=False)
class Design:
    """An experiment: constant `inputs` (U,), measured at `times` (n,); `initial` (D,) is the state at the first time.

    `clock` are the indices of inputs that are the time itself.
    """

    initial: FloatArray
    inputs: FloatArray
    times: FloatArray
    clock: tuple[int, ...] = ()

    def courses(self) -> tuple[FloatArray, FloatArray]:
        """Return the inputs at all times (U, n), and their slopes (U, n)."""
        inputs = np.repeat(self.inputs[:, None], len(self.times), axis=1)
        slopes = np.zeros_like(inputs)
        for index in self.clock:
            inputs[index], slopes[index] = self.times, 1.0
        return inputs, slopes


@dataclass(frozen=True, eq=False)
class DesignPrediction:
    """The prediction of a candidate for an experiment, in standard errors of the measurements.

    `values` (n, O) are the predicted states. `spread` (n, O, P + D) are their derivatives. The first P derivatives are
    with respect to the constants, times a root of the covariance of the constants; the last D are with respect to the
    initial state, times the widths of its bounds. `reached` is the number of rows before the simulation diverges.
    """

    values: FloatArray
    spread: FloatArray
    reached: int


@dataclass(frozen=True, eq=False)
class DesignPredictor:
    """Simulates a candidate for experiments.

    `widths` (D,) are the widths of the bounds of initial states. A state outside of `limits` (D, 2) counts as diverged.
    `sigmas` (O,) are the standard errors of a measurement.
    """

    fitted: EquationSetFit
    widths: FloatArray
    limits: FloatArray
    sigmas: FloatArray

    def at(self, design: Design) -> DesignPrediction:
        """Return the prediction for an experiment."""
        measurements, fit = self.fitted.measured.measurements, self.fitted.fit
        states, count, rows = len(measurements.scales), len(fit.system.places), len(design.times)
        inputs, slopes = design.courses()
        simulated, gradients = np.full((states, rows), np.nan), np.zeros((rows, states, count + states))
        integrate_segments(
            STIFF if fit.is_stiff else PRECISE, fit.system.tape, fit.system.owners, (design.times, inputs, slopes),
            np.array([[0, rows]], dtype=np.int64), np.ascontiguousarray(design.initial[None]),
            fit.estimator.tolerance * measurements.scales, self.limits,
            200 + STEPS_PER_ROW * rows, True, simulated, gradients, np.zeros(1, dtype=np.int64),
        )  # fmt: skip
        reached = int(np.isfinite(simulated).all(axis=0).sum())
        by_all = gradients[:, measurements.observed] / self.sigmas[:, None]
        root, sharing = self.fitted.root, fit.system.sharing
        if sharing is not None:  # several constants are multiples of one fitted number
            root = root[sharing.columns[0]] * sharing.multiples[:, None]
        spread = np.concatenate([by_all[..., :count] @ root, by_all[..., count:] * self.widths], axis=2)
        return DesignPrediction(simulated[measurements.observed].T / self.sigmas, spread, reached)


def discrepancy(first: DesignPrediction, second: DesignPrediction) -> float:
    """Return d' (S_i + S_j)^-1 d of two candidates, over the rows that both simulations reach."""
    rows = min(first.reached, second.reached)
    difference = (first.values[:rows] - second.values[:rows]).ravel()
    spread = np.concatenate([first.spread[:rows], second.spread[:rows]], axis=2).reshape(len(difference), -1)
    if not rows or not np.isfinite(spread).all():
        return 0.0
    known, directions = eigenaxes(spread.T @ spread, 0.0)
    along = directions.T @ (spread.T @ difference)
    explained = float((along**2 / (2.0 + known)).sum())
    return max(0.5 * (float(difference @ difference) - explained), 0.0)


@dataclass(frozen=True)
class Gain:
    """The expected gain of an experiment, in nats.

    `information` is the information about the right candidate, or about the constants of one candidate. `evidence` is
    the Δ log-likelihood for the right candidate, at most four times `FARTHEST`. `worth` ranks experiments.
    """

    information: float
    evidence: float
    worth: float


NONE: Final = Gain(0.0, 0.0, 0.0)
FARTHEST: Final = 500.0
"""Largest Bhattacharyya distance. A candidate that cannot be simulated along an experiment has this distance. exp(-500)
is negligible, and larger distances occur only far outside of the data."""


def useful_evidence(lengths: Sequence[float]) -> FloatArray:
    """Return the useful evidence (C, C), in nats, for candidate i against j, from the C description lengths so far.

    This evidence makes the description of i distinctly shorter than the description of j. Two standard deviations are
    added, because evidence with the mean k has the variance 2 k. More evidence has no further worth.
    """
    behind = np.maximum(np.subtract.outer(lengths, lengths), 0.0) + SETTINGS.inference.distinct_nats
    return np.asarray(behind + 2.0 * np.sqrt(2.0 * behind))


def expected_gain(distances: FloatArray, weights: Sequence[float], useful: FloatArray) -> Gain:
    """Return the expected gain of an experiment from the Bhattacharyya distances (C, C) between C candidates.

    The worth is the evidence, limited for each pair of candidates to the `useful` (C, C) amount.
    """
    shares = np.asarray(weights)
    kept = np.flatnonzero(shares > 0.0)  # candidates that the data have excluded contribute 0 ln 0 = 0
    shares, distances, useful = shares[kept], distances[np.ix_(kept, kept)], useful[np.ix_(kept, kept)]
    information = -float(shares @ np.log(np.exp(-distances) @ shares))
    pairs = np.outer(shares, shares) / np.maximum(1.0 - shares, 1e-300)[:, None]
    evidence = 4.0 * distances
    return Gain(
        max(information, 0.0), float((pairs * evidence).sum()), float((pairs * np.minimum(evidence, useful)).sum())
    )


def distances_of(predictions: Sequence[DesignPrediction], weights: Sequence[float]) -> FloatArray:
    """Return the first-order Bhattacharyya distances (C, C) between the predictions of C candidates.

    All are 0 if the candidate with the largest weight cannot be simulated along the experiment.
    """
    count = len(predictions)
    distances = np.zeros((count, count))
    if predictions[int(np.argmax(weights))].reached < len(predictions[0].values):
        return distances
    for i in range(count):
        for j in range(i):
            distances[i, j] = distances[j, i] = min(0.25 * discrepancy(predictions[i], predictions[j]), FARTHEST)
    return distances


def certainties(distances: FloatArray, weights: Sequence[float]) -> tuple[float, ...]:
    """Return lower bounds of the probability that an experiment distinguishes candidate 1 correctly from each other.

    The bounds assume that one of the two candidates is right. The probability that the more likely candidate is wrong
    is at most sqrt(v_i v_j) exp(-B_ij) (Bhattacharyya 1943); v are the weights of the two candidates, with the sum 1.
    Without an experiment, this probability is the smaller weight.
    """
    sure = []
    for other in range(1, len(weights)):
        both = weights[0] + weights[other]
        shares = (weights[0] / both, weights[other] / both) if both > 0.0 else (0.5, 0.5)
        distance = float(min(distances[0, other], distances[other, 0]))
        error = math.sqrt(shares[0] * shares[1]) * math.exp(-distance)
        sure.append(max(1.0 - error, *shares))
    return tuple(sure)


def distance_after(
    ahead: EquationSetFit, fitted: EquationSetFit, design: Design, prediction: DesignPrediction, sigmas: FloatArray
) -> float:
    """Return the Bhattacharyya distance of two candidates after an experiment with the outcome `prediction`.

    The candidate `ahead` is assumed to be right and has predicted the outcome. The candidate `fitted` is fitted to the
    data and this outcome. `sigmas` (O,) are the measurement errors.
    """
    measurements = ahead.measured.measurements
    longer = with_trajectory(measurements, design, prediction.values.T * sigmas[:, None])
    before, steps = fitted.fit, SETTINGS.effort.steps
    estimator = MultipleShooting(longer, before.estimator.tolerance)
    added = np.zeros(before.starts.shape[1])  # the initial state, and offsets of 0
    added[: len(design.initial)] = design.initial
    starts = np.concatenate([before.starts, added[None]])
    fit = estimator.fit(before.system, None, steps, starts, fitted.errors, is_stiff=before.is_stiff)
    if fit is None:
        staged = estimator.fit(before.system, SETTINGS.shooting.lengths[0], steps, None, fitted.errors)
        if staged is not None:
            starts = np.ascontiguousarray(staged.simulated[:, longer.bounds[:, 0]].T)
            fit = estimator.fit(staged.system, None, steps, starts, fitted.errors, is_stiff=before.is_stiff)
    if fit is None:
        return FARTHEST
    return min(max(estimator.cost(fit) - before.estimator.cost(before), 0.0) / 8.0, FARTHEST)


def with_trajectory(measurements: TrajectoryMeasurements, design: Design, values: FloatArray) -> TrajectoryMeasurements:
    """Return the measurements with one more trajectory, whose measured values are `values` (O, n)."""
    rows, count = len(design.times), measurements.rows
    states = np.repeat(design.initial[:, None], rows, axis=1)
    states[measurements.observed] = values
    inputs, slopes = design.courses()
    ones = np.ones_like(values)

    def join(left: FloatArray, right: FloatArray) -> FloatArray:
        return np.ascontiguousarray(np.concatenate([left, right], axis=1))

    inverse, resting = measurements.inverse_variances, measurements.resting
    return replace(
        measurements,
        bounds=np.concatenate([measurements.bounds, [[count, count + rows]]]),
        owners=np.append(measurements.owners, len(measurements.names)),
        times=np.concatenate([measurements.times, design.times]),
        measured=join(measurements.measured, values),
        weights=join(measurements.weights, ones),
        smoothed=join(measurements.smoothed, states),
        inputs=join(measurements.inputs, inputs),
        input_slopes=join(measurements.input_slopes, slopes),
        names=(*measurements.names, "experiment"),
        inverse_variances=None if inverse is None else join(inverse, ones),
        resting=None if resting is None else np.concatenate([resting, ones == 0.0], axis=1),
    )


def precision(prediction: DesignPrediction, constants: int) -> tuple[Gain, FloatArray]:
    """Return the expected gain for the constants, and the share (P, P) of their covariance that remains.

    If L is a root of the covariance before the experiment, the covariance after it is L (shares) L'.
    """
    if prediction.reached < len(prediction.values):
        return NONE, np.eye(constants)
    by_all = prediction.spread.reshape(-1, prediction.spread.shape[2])
    of, free = by_all[:, :constants], by_all[:, constants:]
    known, directions = eigenaxes(free.T @ free, 0.0)
    along = directions.T @ (free.T @ of)
    information = of.T @ of - along.T @ (along / (1.0 + known)[:, None])
    factors, directions = eigenaxes(np.eye(constants) + information, 1.0)
    gain = 0.5 * float(np.log(factors).sum())
    return Gain(gain, 0.0, gain), directions / factors @ directions.T


MOST_SAMPLES: Final = 2_000
MOST_SUGGESTIONS: Final = 20
_POINTS: Final = 192
"""Number of points all over the bounds, for experiments of all lengths together."""
_FEWEST_POINTS: Final = 32
_MOST_CORNERS: Final = 32
_CORNER: Final = 0.02
"""Distance of points from the corners, in widths of the bounds: exactly at a corner, a rate may be undefined."""
_SHORTER: Final = (1.0, 0.5, 0.25, 0.125)
"""Tried shares of the largest duration or number of samples, if the duration or the samples have a cost."""
_FEWEST_SAMPLES: Final = 8
_SMALLEST_DIFFERENCE: Final = 0.25
"""Smallest difference between two suggestions, in widths of the bounds, in at least one number."""


@dataclass(frozen=True)
class DesignRequest:
    """A request for suggestions.

    `bounds` are the bounds of initial states and inputs by name; the default is the range of the data. `duration` and
    `samples` describe an experiment; None stands for the median of the measured trajectories. `cost` is the kind of its
    cost, and `count` the number of suggestions. `rivals` are alternative models: right-hand sides by state.
    """

    bounds: Mapping[str, tuple[float, float]]
    duration: float | None = None
    samples: int | None = None
    cost: Cost = "trajectory"
    count: int = 3
    seed: int = 0
    rivals: Sequence[Mapping[str, str]] = ()

    def check(self) -> None:
        """Raise UsageError if a number is out of range."""
        if self.cost not in COSTS:
            raise UsageError(f"the cost must be {', '.join(COSTS[:-1])} or {COSTS[-1]}, but {self.cost!r} was given")
        if self.duration is not None and not (math.isfinite(self.duration) and self.duration > 0.0):
            raise UsageError(f"the duration of an experiment must be above 0, but {self.duration!r} was given")
        if self.samples is not None and not 2 <= self.samples <= MOST_SAMPLES:
            raise UsageError(f"an experiment must have 2 to {MOST_SAMPLES} samples, but {self.samples!r} were given")
        if not 1 <= self.count <= MOST_SUGGESTIONS:
            raise UsageError(f"the count of suggestions must be 1 to {MOST_SUGGESTIONS}, but {self.count!r} was given")


@dataclass(frozen=True, eq=False)
class DesignSpace:
    """The possible experiments: initial values of `states` and constant `inputs`, both within `box`.

    `clock` are the indices of inputs that are the time itself. `begin` is the first time. `duration` and `samples`
    belong to the longest experiment. `measured` is the box of the smoothed data. A point of the space is an array (n,)
    of initial values, then of the inputs that can be chosen.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    clock: tuple[int, ...]
    box: Box
    begin: float
    duration: float
    samples: int
    cost: Cost
    measured: Box

    @property
    def free(self) -> tuple[int, ...]:
        """The indices of the inputs that can be chosen."""
        return tuple(index for index in range(len(self.inputs)) if index not in self.clock)

    @property
    def names(self) -> tuple[str, ...]:
        """The states and the inputs that can be chosen, in the order of a point."""
        return (*self.states, *(self.inputs[index] for index in self.free))

    @property
    def widths(self) -> FloatArray:
        """The widths (D,) of the bounds of initial states."""
        return np.asarray(self.box.widths[: len(self.states)])

    def limits(self, measured: FloatArray) -> FloatArray:
        """Return the range (D, 2) outside of which a state has diverged, from measured states (D, N) and the bounds."""
        low = np.minimum(self.box.lower[: len(self.states)], measured.min(axis=1))
        high = np.maximum(self.box.upper[: len(self.states)], measured.max(axis=1))
        reach = BLOW_UP_WIDTHS * np.maximum(high - low, 1e-300)
        return np.ascontiguousarray(np.stack([low - reach, high + reach], axis=1))

    @property
    def shares(self) -> tuple[float, ...]:
        """Shares of the longest experiment that are tried."""
        return (1.0,) if self.cost == "trajectory" else _SHORTER

    def points(self, seed: int) -> FloatArray:
        """Return points (m, n) all over the bounds and, if there are few corners, near the corners."""
        size, inner = len(self.box.lower), self.box.points(max(_POINTS // len(self.shares), _FEWEST_POINTS), seed)
        if 2**size > _MOST_CORNERS:
            return inner
        sides = np.meshgrid(*([(_CORNER, 1.0 - _CORNER)] * size), indexing="ij")
        corners = np.array(sides).reshape(size, -1).T
        return np.concatenate([inner, self.box.lower + corners * self.box.widths])

    def design(self, point: FloatArray, share: float) -> Design:
        """Return the experiment at a point, with a share of the longest duration or of the samples."""
        duration = self.duration * (share if self.cost == "duration" else 1.0)
        fewest = min(_FEWEST_SAMPLES, self.samples)
        samples = max(round(self.samples * share), fewest) if self.cost == "samples" else self.samples
        inputs = np.zeros(len(self.inputs))
        inputs[list(self.free)] = point[len(self.states) :]
        times = self.begin + np.linspace(0.0, duration, samples)
        return Design(np.array(point[: len(self.states)]), inputs, times, self.clock)

    def point(self, design: Design) -> FloatArray:
        """Return the point of an experiment."""
        return np.concatenate([design.initial, design.inputs[list(self.free)]])

    def share(self, design: Design) -> float:
        """Return the share of the longest experiment."""
        return self.price(design) / {"trajectory": 1.0, "duration": self.duration, "samples": self.samples}[self.cost]

    def price(self, design: Design) -> float:
        """Return the cost of an experiment."""
        duration, samples = float(design.times[-1] - design.times[0]), float(len(design.times))
        return {"trajectory": 1.0, "duration": duration, "samples": samples}[self.cost]

    def around(self, point: FloatArray, step: float) -> Iterator[FloatArray]:
        """Yield the points within the bounds that differ in one number by `step` widths."""
        for index, width in enumerate(self.box.widths.tolist()):
            for moved_by in (-step * width, step * width):
                moved = point.copy()
                moved[index] = np.clip(moved[index] + moved_by, self.box.lower[index], self.box.upper[index])
                yield moved

    def are_distinct(self, first: Design, second: Design) -> bool:
        """Tell whether two experiments differ in at least one number by a quarter of the width of its bounds."""
        differences = np.abs(self.point(first) - self.point(second)) / np.maximum(self.box.widths, 1e-300)
        return bool(differences.max() >= _SMALLEST_DIFFERENCE)


def space_of(result: Result, measured: FitData, request: DesignRequest) -> DesignSpace:
    """Return the experiments that a request allows; raises UsageError if its bounds are invalid for the result."""
    measurements, symbols = measured.measurements, result.symbols
    count = len(measurements.scales)
    states, inputs = measurements.variables[:count], measurements.variables[count:]
    time = symbols.get(result.columns.time or "")
    clock = tuple(index for index, name in enumerate(inputs) if name == time)
    free = [index for index in range(len(inputs)) if index not in clock]
    names = [*states, *(inputs[index] for index in free)]
    given = {symbols.get(name, name): ends for name, ends in request.bounds.items()}
    for name, (low, high) in given.items():
        if name not in names:
            raise UsageError(f"the bounds have '{name}', but an experiment has {', '.join(names)}")
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise UsageError(f"the bounds {low:g}:{high:g} of '{name}' are not an interval; give LOWER:UPPER")
    values = np.concatenate([measurements.smoothed, measurements.inputs[free]])
    measured_box = Box(values.min(axis=1), values.max(axis=1))
    ranges = zip(names, measured_box.lower.tolist(), measured_box.upper.tolist(), strict=True)
    lower, upper = np.array([given.get(name, (low, high)) for name, low, high in ranges]).T.copy()
    box = Box(lower, upper)
    begin = float(np.median(measurements.inputs[clock[0]][measurements.bounds[:, 0]])) if clock else 0.0
    whole = [measurements.times[measurements.owners_of_rows == owner] for owner in np.unique(measurements.owners)]
    median_duration = float(np.median([times[-1] - times[0] for times in whole]))
    rows = float(np.median([len(times) for times in whole])) * measured.rows / measurements.rows
    samples = int(request.samples or min(max(round(rows), 2), MOST_SAMPLES))
    duration = float(request.duration or median_duration)
    return DesignSpace(states, inputs, clock, box, begin, duration, samples, request.cost, measured_box)
