"""Laws of one state as sums of products, by backward elimination: from full libraries to what is significant."""

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import numpy as np

from atoll.config import JobConfig
from atoll.data.dataset import FloatArray, Problem
from atoll.expression.evaluation import values_of
from atoll.expression.operators import ADD, BY_NAME, MULTIPLY
from atoll.expression.program import Program, constant_places, structure
from atoll.expression.writing.shortest import collected
from atoll_coordinator.data.recording import Preparation, Recording
from atoll_coordinator.model.criteria import constant_nats_of, structure_length
from atoll_coordinator.model.refinement import may_be_shown
from atoll_coordinator.model.sparse.kernels.elimination import eliminate
from atoll_coordinator.model.sparse.products import products_of
from atoll_coordinator.model.sparse.weak_form import Measured, WeakForm, measured_of, weak_form
from atoll_coordinator.model.structure.term_libraries import Factor, Term, sum_of
from atoll_coordinator.settings import SETTINGS


@dataclass(frozen=True, eq=False)
class Law:
    """A sum of products: its `program`, the `nats` by which laws of one state compare, and how well it fits.

    `excess` is how many times as large as the noise, or as the limit of convergence, the errors are. `is_tested` tells
    whether there are enough rows for the largest library that it was chosen from. `lead` is how many nats longer the
    best of the other programs is that were compared with it and are no sums of products. `probability` is that of
    errors as large as these where all are noise.
    """

    program: Program
    nats: float
    excess: float
    is_tested: bool
    lead: float = math.inf
    probability: float = 1.0


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


def has_laws(preparation: Preparation, config: JobConfig) -> bool:
    """Tell whether each equation that is sought has a law that needs no long search to compare it with.

    That is a law whose errors are those of noise, chosen on more rows than systems are compared on. Not where the user
    has said when the search ends or where it begins.
    """
    dataset, recording, budget = preparation.dataset, preparation.recording, config.budget
    is_asked = budget.target_error is not None or budget.stagnation is not None or bool(config.prior.guesses)
    if recording is None or is_asked:
        return False
    if sum(len(each.times) for each in recording.trajectories if not each.held_out) <= SETTINGS.selection.compared_rows:
        return False
    for name in dataset.variables:
        if name in config.prior.known:
            continue
        columns = config.space.columns_for(name, dataset.names)
        operators = [BY_NAME[operator].code for operator in config.space.operators_for(name)]
        laws = find_laws(dataset.problem(name), recording, columns, operators)
        if not laws or not may_be_shown(laws[0].program, config.space.max_size):
            return False
        if not laws[0].is_tested or laws[0].probability < SETTINGS.inference.improbable:
            return False
    return True


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
    libraries = list(_libraries(columns, form.independent))
    if not libraries:
        return
    largest, is_tested = libraries[-1]
    regression = _Regression(form, largest)
    summed = [products_of(program, SETTINGS.sparse.degree) for program in others]
    begun = {tuple(terms): None for terms in (*(terms for terms, _ in libraries), *filter(None, summed))}
    found = [regression.law(terms, is_tested=is_tested) for terms in begun if set(terms) <= set(largest)]
    laws = sorted((law for law in found if law is not None), key=lambda law: law.nats)
    if not laws:
        return
    functions = (program for program, terms in zip(others, summed, strict=True) if terms is None)
    rival = min((_nats_of(form, program) for program in functions), default=math.inf)
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
    return max(min(span or most, most, longest // SETTINGS.sparse.least_windows), 2 * SETTINGS.sparse.smoothness)


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
    """Return minus the log-likelihood of what is left in the windows (W,), each counted by its share in a new one.

    That of the true states nearest to the measured ones for which the equation holds, to first order: half the square
    over its variance. The variance depends on the equation, the density of the measurements about these states does
    not: with its logarithm, sums that vary little with the states would be preferred (errors in variables, functional
    case: Fuller 1987, section 2.3).
    """
    if not (variances > 0.0).all():
        return math.inf
    return 0.5 * form.independent * float((left * left / variances).mean())


class _Regression:
    """Sums of the products of one library, the largest, by which windows are described."""

    def __init__(self, form: WeakForm, terms: Sequence[Term]) -> None:
        self._form = form
        self._terms = terms
        self._places = {term: place for place, term in enumerate(terms)}
        self._columns, self._sides = form.columns(terms), form.sides
        prices = [structure_length(sum_of([term], [1.5])) for term in terms]
        self._prices = np.array(prices) + constant_nats_of(form.independent)

    def law(self, begun: Sequence[Term], *, is_tested: bool) -> Law | None:
        """Return the sum that a search from all terms `begun` ends with, windows weighted by its own variances."""
        from scipy import special

        form, start = self._form, [self._places[term] for term in begun]
        if not np.isfinite(self._columns).all() or len(start) >= len(self._sides):
            return None
        weights = np.ones(len(self._sides))
        for reweighting in range(SETTINGS.sparse.reweightings):
            kept, coefficients = self._best_sum(start, weights, is_extended=reweighting > 0)
            terms = [self._terms[place] for place in kept]
            variances = form.variances(terms, coefficients)
            if not (variances > 0.0).all():
                return None
            weights = 1.0 / np.sqrt(variances)
        left = self._sides - np.array(coefficients) @ self._columns[kept]
        length = _misfit(form, left, variances) + float(self._prices[kept].sum())
        square = float((left * left / variances).mean())
        probability = float(special.chdtrc(form.independent, form.independent * square))
        return Law(sum_of(terms, coefficients), length, math.sqrt(square), is_tested, probability=probability)

    def _best_sum(
        self, start: Sequence[int], weights: FloatArray, *, is_extended: bool
    ) -> tuple[list[int], list[float]]:
        """Return the terms of the shortest description that is found from those of `start`, and their coefficients.

        Elimination may lose a term early for others that it nearly depends on. So single terms are taken in again,
        and what the sum can then do without eliminated, as long as that is shorter by more than the best of so many
        tries is by chance (Bonferroni).
        """
        columns, sides = self._columns * weights, self._sides * weights
        best = self._eliminated(start, columns, sides)
        while is_extended:
            others = [place for place in range(len(self._terms)) if place not in best[1]]
            longer = (self._eliminated(sorted([*best[1], place]), columns, sides) for place in others)
            found = min(longer, default=best)
            if not others or not found[0] < best[0] - math.log(len(others)):
                break
            best = found
        return best[1], best[2]

    def _eliminated(
        self, places: Sequence[int], columns: FloatArray, sides: FloatArray
    ) -> tuple[float, list[int], list[float]]:
        """Return the nats, terms and coefficients of the best sum on the way from these terms to none."""
        path = _eliminated([self._terms[place] for place in places], columns[places], sides)
        independent = self._form.independent
        nats = []
        for step in range(len(places)):
            price = float(self._prices[[places[index] for index in path.kept(step)]].sum())
            nats.append(0.5 * independent * math.log(max(float(path.squares[step]), 1e-300)) + price)
        step = int(np.argmin(nats))
        return nats[step], [places[index] for index in path.kept(step)], path.sum(step)[1]
