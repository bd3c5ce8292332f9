"""Coordinates of a hidden state: proposals for its course, from measured states, rates and inputs. Pure.

How it works. If a measured state obeys ``dy/dt = f(y, h, u)`` and f changes monotonically with h, then h is determined
by y, its rate and the inputs. Any such function is a possible coordinate, since nothing measures h itself. A law is
short in few coordinates only, so several are proposed:

1. The rate dy/dt: so an equation of second order becomes two equations.
2. The relative rate (dy/dt)/y of a positive state: growth that depends on a hidden state, as of prey and predator.
3. Coordinates of the linear law with inputs ``y'' = p y' + q u' + r y + s u + c``, which is fitted in integrated form
   (identification of a linear state space): ``dy/dt - p y - q u``, whose equation does not contain itself; and
   ``dy/dt - e y``, with e a real eigenvalue, whose equation does not contain y (one tank after another).
4. With several measured states: principal components of those parts of all rates that no linear law of the measured
   states and inputs describes.

Doubts. Noise of a rate is much larger than noise of a state, so a course proposed here is only a start; the alternation
replaces it by a course that fits the measured states. Coordinates of two and more hidden states are further rates.

Letters: H hidden states, S measured states, U inputs, R rows of one trajectory, T trajectories.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np

from atoll_coordinator.data.recording import Recording, Trajectory
from atoll_coordinator.model.sparse.atoms import Product, expression_of, sum_of
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import Program
from atoll_core.expression.writing.expansion import terms_of

_LARGEST_SCALE: Final = 10.0
"""Largest factor of a hidden state, or its inverse. It is set by hand: searches draw constants of the order of one.
With values of h of 0.01, the forecasts of the cascaded tanks had an RMSE of 0.44 to 0.49 V instead of 0.35 V."""
_REAL: Final = 1e-9
"""Largest relative imaginary part of an eigenvalue that counts as real: rounding errors."""


@dataclass(frozen=True, eq=False)
class Course:
    """The course of hidden states: `values` and `rates` (H, R), by trajectory; `coordinates` names what they are."""

    coordinates: str
    values: tuple[FloatArray, ...]
    rates: tuple[FloatArray, ...]

    @property
    def is_finite(self) -> bool:
        """Whether all values and rates are finite numbers."""
        return all(np.isfinite(part).all() for part in (*self.values, *self.rates))

    def normalised(self, recording: Recording) -> "Course":
        """Return the course with mean 0 and standard deviation 1 over the trajectories that are not held out."""
        kept = [place for place, part in enumerate(recording.trajectories) if not part.held_out]
        whole = np.concatenate([self.values[place] for place in kept], axis=1)
        mean, scale = whole.mean(axis=1, keepdims=True), whole.std(axis=1, keepdims=True)
        scale = np.where(scale > 0.0, scale, 1.0)
        return Course(
            self.coordinates,
            tuple(np.ascontiguousarray((part - mean) / scale) for part in self.values),
            tuple(np.ascontiguousarray(part / scale) for part in self.rates),
        )

    def scaled(self, factors: Sequence[float]) -> "Course":
        """Return the course with each hidden state multiplied by its factor (H)."""
        by = np.array(factors)[:, None]
        return Course(
            self.coordinates, tuple(np.ascontiguousarray(by * part) for part in self.values),
            tuple(np.ascontiguousarray(by * part) for part in self.rates),
        )  # fmt: skip


def scale_hidden_states(
    programs: Mapping[str, Program], hidden: Mapping[str, int]
) -> tuple[dict[str, Program], dict[str, float]]:
    """Return sums of products in which a coefficient of each hidden state is 1, and the factors of the states.

    Nothing else fixes the scale of a hidden state h, and a coefficient that only fixes the scale is not determined by
    the data. The coefficient is of the first equation that has h times known states, measured or scaled before, and
    there of the product with the fewest factors. A state without such a product keeps its scale, and so does one that
    would get values far from one.

    Args:
        programs: sums of products by equation, the measured states first.
        hidden: the variable (index) of each hidden state, by equation.
    """
    sums = {name: _products_of(program) for name, program in programs.items()}
    factors, unknown = dict.fromkeys(hidden, 1.0), dict(hidden)
    while unknown:
        name, factor = next(
            (
                (name, factor)
                for name, place in unknown.items()
                for other, terms in sums.items()
                if other not in unknown
                for term, factor in sorted(terms, key=lambda one: len(one[0]))
                if term.count(place) == 1 and not any(term.count(one) for one in unknown.values() if one != place)
                if 1.0 / _LARGEST_SCALE <= abs(factor) <= _LARGEST_SCALE
            ),
            (None, 1.0),
        )
        if name is None:
            break
        place, factors[name] = unknown.pop(name), factor
        for other, terms in sums.items():
            own = factor if other == name else 1.0
            sums[other] = [(term, own * one / factor ** term.count(place)) for term, one in terms]
    scaled = {  # a sum whose terms cancel has no products
        name: sum_of([expression_of(term) for term, _ in terms], [one for _, one in terms]) if terms else programs[name]
        for name, terms in sums.items()
    }
    return scaled, factors


def _products_of(program: Program) -> list[tuple[Product, float]]:
    """Return the products of a sum of products, each with its coefficient."""
    return [
        (tuple(sorted(atom[1] for atom, power in monomial for _ in range(power))), factor)
        for monomial, factor in terms_of(program)
    ]


def propose_courses(recording: Recording, count: int) -> list[Course]:
    """Return the proposals for the course of `count` hidden states, normalised; all of them are finite."""
    states = len(recording.states) - len(recording.hidden)
    proposals = [*_rates(recording, states, count)]
    if count == 1 and states == 1:
        proposals += _linear_coordinates(recording)
    if states > 1 and count <= states:
        proposals.append(_unexplained_rates(recording, states, count))
    normalised = [course.normalised(recording) for course in proposals if course.is_finite]
    return [course for course in normalised if course.is_finite]


def _made(coordinates: str, recording: Recording, make: Callable[[Trajectory], FloatArray]) -> Course:
    """Return the course whose values `make` computes for each trajectory; rates are differences."""
    with np.errstate(all="ignore"):
        values = [make(part) for part in recording.trajectories]
    return Course(
        coordinates, tuple(values),
        tuple(_gradient(course, part.times) for course, part in zip(values, recording.trajectories, strict=True)),
    )  # fmt: skip


def _gradient(values: FloatArray, times: FloatArray) -> FloatArray:
    return np.asarray(np.gradient(values, times, axis=1, edge_order=2 if len(times) > 2 else 1))


def _rates(recording: Recording, states: int, count: int) -> Iterator[Course]:
    """Yield the rates of each measured state, and the relative rates of each positive state."""
    for place in range(states):
        name = recording.states[place]
        yield _made(f"rate of {name}", recording, partial(_derivatives, place, count, is_relative=False))
        if all((part.smoothed[place] > 0.0).all() for part in recording.trajectories):
            yield _made(f"relative rate of {name}", recording, partial(_derivatives, place, count, is_relative=True))


def _derivatives(place: int, count: int, part: Trajectory, *, is_relative: bool) -> FloatArray:
    """Return the rate of a state along a trajectory, or its relative rate, and derivatives of it (`count` rows)."""
    first = part.slopes[place : place + 1]
    orders = [first / part.smoothed[place : place + 1] if is_relative else first]
    while len(orders) < count:
        orders.append(_gradient(orders[-1], part.times))
    return np.concatenate(orders)


def _linear_coordinates(recording: Recording) -> Iterator[Course]:
    """Yield the coordinates of the linear law of second order of the only measured state."""
    fitted = _fit_linear_law(recording)
    p, r, q = fitted[0], fitted[1], fitted[2 : 2 + len(recording.inputs)]

    def without(own: float, of_inputs: FloatArray | None = None) -> Callable[[Trajectory], FloatArray]:
        return lambda part: np.asarray(
            part.slopes[:1] - own * part.smoothed[:1] - (0.0 if of_inputs is None else of_inputs @ part.inputs)
        )

    yield _made("observer form of a linear law", recording, without(p, q))
    for number, value in enumerate(np.roots([1.0, -p, -r])):
        if abs(value.imag) <= _REAL * abs(value):
            yield _made(f"mode {number + 1} of a linear law", recording, without(float(value.real)))


def _fit_linear_law(recording: Recording) -> FloatArray:
    """Return p, r, q (U), s (U), c of ``y'' = p y' + r y + q u' + s u + c`` by least squares, integrated twice.

    y' - y'(0) = p (y - y(0)) + r ∫y + q (u - u(0)) + s ∫u + c t; the numbers y'(0) are fitted for each trajectory.
    """
    parts = [part for part in recording.trajectories if not part.held_out]
    rows, sides = list[FloatArray](), list[FloatArray]()
    for place, part in enumerate(parts):
        inputs = [part.inputs[index] for index in range(len(recording.inputs))]
        state, ones = part.smoothed[0], np.zeros((len(parts), len(part.times)))
        ones[place] = 1.0
        columns = [state, _integral(state, part.times), *inputs, *(_integral(one, part.times) for one in inputs)]
        rows.append(np.concatenate([np.array([*columns, part.times - part.times[0]]), ones]))
        sides.append(part.slopes[0])
    matrix = np.concatenate(rows, axis=1)
    scales = np.sqrt((matrix**2).mean(axis=1)) + np.finfo(np.float64).tiny
    solution = np.linalg.lstsq((matrix / scales[:, None]).T, np.concatenate(sides), rcond=1e-10)[0] / scales
    return np.asarray(solution)


def _integral(values: FloatArray, times: FloatArray) -> FloatArray:
    """Return the integral from the first row to each row, by the trapezoidal rule."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(times))])


def _unexplained_rates(recording: Recording, states: int, count: int) -> Course:
    """Return the largest principal components of the parts of the rates that no linear law describes."""
    parts = [part for part in recording.trajectories if not part.held_out]

    def points(part: Trajectory) -> FloatArray:
        return np.concatenate([np.ones((1, len(part.times))), part.smoothed[:states], part.inputs])

    inputs = np.concatenate([points(part) for part in parts], axis=1)
    rates = np.concatenate([part.slopes[:states] for part in parts], axis=1)
    law = np.linalg.lstsq(inputs.T, rates.T, rcond=1e-10)[0].T
    left = rates - law @ inputs
    scales = rates.std(axis=1, keepdims=True)
    scales = np.where(scales > 0.0, scales, 1.0)
    values, vectors = np.linalg.eigh((left / scales) @ (left / scales).T)
    axes = _signed(vectors[:, np.argsort(values, kind="stable")[::-1][:count]]).T
    return _made(
        "rates that no linear law describes", recording,
        lambda part: np.asarray(axes @ ((part.slopes[:states] - law @ points(part)) / scales)),
    )  # fmt: skip


def _signed(vectors: FloatArray) -> FloatArray:
    """Return vectors (S, H) whose largest components are positive."""
    signs: Sequence[float] = [
        float(np.sign(vectors[np.argmax(np.abs(column)), place])) or 1.0 for place, column in enumerate(vectors.T)
    ]
    return np.asarray(vectors * np.array(signs))
