"""Laws of one state as sums of products, by backward elimination: from full libraries to what is significant."""

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import numpy as np

from atoll.data.dataset import FloatArray, Problem
from atoll.expression.evaluation import values_of
from atoll.expression.operators import ADD, MULTIPLY
from atoll.expression.program import Program, constant_places, structure
from atoll.expression.writing.shortest import collected
from atoll_coordinator.data.recording import Recording
from atoll_coordinator.model.criteria import constant_nats_of, structure_length
from atoll_coordinator.model.sparse.kernels.elimination import eliminate
from atoll_coordinator.model.sparse.weak_form import Measured, WeakForm, measured_of, weak_form
from atoll_coordinator.model.structure.term_libraries import Factor, Term, sum_of
from atoll_coordinator.settings import SETTINGS


@dataclass(frozen=True, eq=False)
class Law:
    """A sum of products: its `program`, the `nats` by which laws of one state compare, and how well it fits.

    `excess` is how many times as large as the noise, or as the limit of convergence, the errors are. `is_tested` tells
    whether there are enough rows for the largest library that it was chosen from. `lead` is how many nats longer the
    best of the other programs is that were compared with it.
    """

    program: Program
    nats: float
    excess: float
    is_tested: bool
    lead: float = math.inf


def find_laws(
    problem: Problem,
    recording: Recording,
    columns: Sequence[int],
    operators: Collection[int],
    others: Sequence[Program] = (),
) -> tuple[Law, ...]:
    """Return the laws of one state that its rows single out, the shortest description first; none if there are none.

    Args:
        problem: its derivative on the rows of the search; the target's variable is a state of `recording`.
        recording: what was measured.
        columns: indices of the variables that it may be made of.
        operators: codes of the operators.
        others: programs that laws are compared with where there is noise.
    """
    if not _is_simple(recording) or not {ADD, MULTIPLY} <= set(operators) or not columns:
        return ()
    if not problem.target.is_noisy and all(each.method == "interpolation" for each in recording.smoothing):
        return tuple(_without_noise(problem, columns))
    return tuple(_with_noise(problem, recording, columns, others))


def _is_simple(recording: Recording) -> bool:
    """Tell whether rows count alike, and states are measured without an unknown offset: what the weak form assumes."""
    return (
        recording.order == 1
        and not recording.offsets
        and all(part.weights is None and part.robustness_weights is None for part in recording.trajectories)
    )


def _libraries(columns: Sequence[int], rows: float) -> Iterator[tuple[list[Term], bool]]:
    """Yield all products up to each degree, as far as so many rows decide them, and whether the largest is among them.

    Each term of a library takes `rows_per_term` rows that know nothing of each other.
    """
    degrees = range(1, SETTINGS.sparse.degree + 1)
    found = [[term for order in range(degree + 1) for term in _products(columns, order)] for degree in degrees]
    allowed = [
        terms
        for terms in found
        if len(terms) <= SETTINGS.sparse.largest_library and SETTINGS.sparse.rows_per_term * len(terms) <= rows
    ]
    for terms in allowed:
        yield terms, len(allowed) == len(found)


def _products(columns: Sequence[int], order: int) -> list[Term]:
    return list(combinations_with_replacement([Factor(column) for column in columns], order))


@dataclass(frozen=True, eq=False)
class _Elimination:
    """The sums on the way from a library to nothing: which terms each has, its coefficients, what it leaves."""

    terms: Sequence[Term]
    order: Sequence[int]
    squares: FloatArray
    coefficients: FloatArray

    def kept(self, step: int) -> list[int]:
        return sorted(self.order[step:])

    def sum(self, step: int) -> tuple[list[Term], list[float]]:
        kept = self.kept(step)
        return [self.terms[index] for index in kept], [float(self.coefficients[step, index]) for index in kept]


def _eliminated(terms: Sequence[Term], columns: FloatArray, sides: FloatArray) -> _Elimination:
    count = len(terms)
    order, squares = np.zeros(count, np.int64), np.zeros(count + 1)
    coefficients = np.zeros((count, count))
    eliminate(np.ascontiguousarray(columns), np.ascontiguousarray(sides), order, squares, coefficients)
    return _Elimination(terms, order.tolist(), squares, coefficients)


def _without_noise(problem: Problem, columns: Sequence[int]) -> Iterator[Law]:
    """Yield the smallest sum that has converged, of the library of lowest degree that has one."""
    target, inputs = problem.target, problem.inputs
    limit = target.convergence_error()
    for terms, is_tested in _libraries(columns, len(target.values)):
        values = np.array([np.prod([inputs[each.variable] for each in term], axis=0) * np.ones(inputs.shape[1])
                           for term in terms])  # fmt: skip
        if not np.isfinite(values).all():
            return
        path = _eliminated(terms, values, target.values)
        for step in range(len(terms) - 1, -1, -1):
            kept, coefficients = path.sum(step)
            errors = np.array(coefficients) @ values[path.kept(step)] - target.values
            error = float(np.abs(errors).mean())
            if error <= limit:
                program = sum_of(kept, coefficients)
                yield Law(program, structure_length(program), error / limit, is_tested)
                return


def _with_noise(
    problem: Problem, recording: Recording, columns: Sequence[int], others: Sequence[Program]
) -> Iterator[Law]:
    """Yield the best sum of each library, the shortest description first."""
    its = measured_of(recording, problem.names)
    place = recording.states.index(problem.target.variable)
    target = problem.names.index(recording.state_symbols[place])
    form = weak_form(its, target, _half(its, recording.smoothing[place].span, len(columns)))
    if form is None:
        return
    found = [_weighted(form, terms, is_tested) for terms, is_tested in _libraries(columns, form.independent)]
    laws = sorted((law for law in found if law is not None), key=lambda law: law.nats)
    if not laws:
        return
    rival = min((_nats_of(form, program) for program in others), default=math.inf)
    structures: set[bytes] = set()
    for law in laws:
        key = structure(collected(law.program))
        if key not in structures:
            structures.add(key)
            yield replace(law, lead=rival - laws[0].nats)


def _half(its: Measured, span: int | None, variables: int) -> int:
    """Return the rows of half a window: the smoother's span, as far as windows suffice for the largest library."""
    terms = min(math.comb(variables + SETTINGS.sparse.degree, variables), SETTINGS.sparse.largest_library)
    most = int(len(its.times) / (SETTINGS.sparse.rows_per_term * terms + 2 * len(its.ranges) + 1))
    longest = max(end - start for start, end in its.ranges)
    return max(min(span or most, most, longest // SETTINGS.sparse.least_windows), SETTINGS.sparse.least_half)


def _nats_of(form: WeakForm, program: Program) -> float:
    """Return the nats of another program by the same criterion; infinite where it has no finite value."""
    its = form.its
    steps = np.diag(its.noise)[:, :, None]
    with np.errstate(all="ignore"):
        values = values_of(program, its.values)
        moved = [(values_of(program, its.smoothed + step) - values_of(program, its.smoothed - step)) / (2.0 * size)
                 if size else np.zeros(len(its.times))
                 for step, size in zip(steps, its.noise, strict=True)]  # fmt: skip
    slopes = np.array(moved)
    if not (np.isfinite(values).all() and np.isfinite(slopes).all()):
        return math.inf
    price = structure_length(program) + len(constant_places(program)) * constant_nats_of(form.independent)
    return _misfit(form, form.sides - form.integrals(values), form.variances_of(slopes)) + price


def _misfit(form: WeakForm, left: FloatArray, variances: FloatArray) -> float:
    """Return minus the log-likelihood of what is left in the windows (W,), each counted by its share in a new one."""
    if not (variances > 0.0).all():
        return math.inf
    return 0.5 * form.independent * float((np.log(variances) + left * left / variances).mean())


def _weighted(form: WeakForm, terms: Sequence[Term], is_tested: bool) -> Law | None:
    """Return the best sum of one library, windows weighted by the variance that the sum itself gives them."""
    columns, sides = form.columns(terms), form.sides
    if not np.isfinite(columns).all() or len(terms) >= len(sides):
        return None
    prices = np.array([structure_length(sum_of([term], [1.5])) for term in terms])
    prices += constant_nats_of(form.independent)
    weights = np.ones(len(sides))
    for _ in range(SETTINGS.sparse.reweightings):
        path = _eliminated(terms, columns * weights, sides * weights)
        nats = [
            0.5 * form.independent * math.log(max(float(path.squares[step]), 1e-300)) + prices[path.kept(step)].sum()
            for step in range(len(terms))
        ]
        step = int(np.argmin(nats))
        kept, coefficients = path.sum(step)
        variances = form.variances(kept, coefficients)
        if not (variances > 0.0).all():
            return None
        weights = 1.0 / np.sqrt(variances)
    left = sides - np.array(coefficients) @ columns[path.kept(step)]
    length = _misfit(form, left, variances) + float(prices[path.kept(step)].sum())
    excess = math.sqrt(float((left * left / variances).mean()))
    return Law(sum_of(kept, coefficients), length, excess, is_tested)
