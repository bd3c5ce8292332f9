"""Laws of many variables: short sums of products and of functions with an inner constant, fitted to derivatives or to
short windows.

With six or more variables, libraries of all products up to the fourth degree are too large, and laws have functions
that sums of products cannot replace. Each equation is searched independently: first among polynomials of low degree.
Then products with functions, such as the quotients in Hill's equation, are tried, each as one more term of the sum.
Finally, functions of other laws are tried as terms, since a flux that leaves one state enters another. The searches of
all equations go on in step, in batches: polynomials and functions of each equation, then each longer sum. Reasons and
figures: ADR 0043, 0048 and 0102. Doubt: at most a few functions are added, one at a time. So a law can be missed if two
of its functions fit only together.

Letters: A atoms, K terms, N rows of a regression, W windows of L rows, R rows of all trajectories, V variables.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain
from typing import Final, TypeVar

import numpy as np

from atoll_coordinator.data.differentiation.interpolation import estimate_value_noise, predict_left_out
from atoll_coordinator.data.differentiation.smoothing import Signal
from atoll_coordinator.data.recording import Recording
from atoll_coordinator.model.batches import BatchFunction, Spread
from atoll_coordinator.model.description_length import log
from atoll_coordinator.model.pools import Law
from atoll_coordinator.model.sparse.atoms import (
    Atom,
    Product,
    Term,
    polynomial_libraries,
    product_atoms,
    products_with_functions,
)
from atoll_coordinator.model.sparse.pursuit import fit_inner_constants, fit_sum, rank_functions
from atoll_coordinator.model.sparse.regression import SparseRegression, Sum, shortest
from atoll_coordinator.model.sparse.rows import (
    CAUCHY,
    NORMAL_DEVIATION,
    Assessment,
    MeasuredRows,
    OfTerms,
    RateRows,
    RegressionRows,
    WeakRows,
    measured_rows_of,
    window_integrals,
    windows_of,
)
from atoll_coordinator.model.thinning import thinned_places
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import operators_in

_DEGREES: Final = range(1, SETTINGS.sparse.degree + 1)
_LOW: Final = 2
"""Number of degrees of polynomials that are tried before functions."""
_KEPT: Final = 2
"""For each start sum of a search, this number of functions is kept; these functions become terms of a library."""

# ------------------------------------------------------------------------------------------------ short windows

_CUBIC, _LINE = 3, 1
_SMOOTHNESS: Final = 2
"""The power p of the test functions (1 - s^2)^p: the smallest power for which the slope vanishes at both ends."""
_WIDER: Final = 1.5
"""Ratio of successive half widths that are tried."""
_RESOLVED: Final = 0.75
"""Windows get wider as long as linear interpolation between rows is accurate enough in this share of the windows:
within the noise, it must give the same result as cubic interpolation."""


@dataclass(frozen=True, eq=False)
class ShortWindows(WeakRows):
    """Windows that are as short as the sampling allows. They are for states that change one after another.

    Functions are interpolated by cubics between rows, and the product with the test function is integrated exactly.
    `coarse` are the weights (W, L) of test functions and their derivatives for linear interpolation between rows. The
    difference between the integrals by cubic and by linear interpolation counts as an error.
    """

    coarse: tuple[FloatArray, FloatArray]

    @cached_property
    def _own(self) -> FloatArray:
        """The variances (W,) of the left sides that are due to errors of measurement."""
        return np.asarray((self.slope**2).sum(axis=1) * self.measured.noise[self.target] ** 2)

    @cached_property
    def _target_quadrature(self) -> FloatArray:
        """The errors (W,) of the integration of the left sides."""
        target = self.measured.values[self.target : self.target + 1]
        return np.asarray(-window_integrals(self.first, self.slope - self.coarse[1], target)[0])

    @cached_property
    def _quadrature(self) -> FloatArray:
        """The weights (W, L) of the differences between integrals by cubic and by linear interpolation."""
        return self.bump - self.coarse[0]

    @cached_property
    def _values_of(self) -> OfTerms[FloatArray]:
        """The values (R,) of a term."""
        return OfTerms(lambda atom: atom.values)

    @cached_property
    def side_errors(self) -> FloatArray:
        """The standard errors (W,) of the left sides, with errors of the integration."""
        return np.sqrt(np.maximum(self._own + self.widen(self._target_quadrature) ** 2, 1e-300))

    def assess(self, atoms: Sequence[Atom], coefficients: Sequence[float], residuals: FloatArray) -> Assessment:
        """Return the assessment as for long windows, but with errors of the integration.

        In some windows a function changes too fast for the integration. So large residuals have less weight (Cauchy),
        and the excess follows from the median.
        """
        values = sum(c * self._values_of(atom) for c, atom in zip(coefficients, atoms, strict=True))
        difference = window_integrals(self.first, self._quadrature, np.asarray(values)[None])[0]
        quadrature = self.widen(self._target_quadrature - difference)
        variances = np.maximum(self.variances(atoms, coefficients), 1e-300) + quadrature**2
        squares = residuals**2 / variances
        widths = 1.0 + squares / CAUCHY**2
        misfit = 0.5 * self.independent * CAUCHY**2 * math.fsum(np.log(widths).tolist()) / len(widths)
        free = max(self.independent - len(atoms), 1.0)  # degrees of freedom: Rousseeuw & Leroy 1987, section 5.1
        excess = NORMAL_DEVIATION * math.sqrt(self.independent / free * float(np.sort(squares)[len(squares) // 2]))
        return Assessment(1.0 / np.sqrt(variances * widths), misfit, excess)

    def widen(self, errors: FloatArray) -> FloatArray:
        """Return, for each window, the largest absolute value of `errors` (W,) in this window and in all windows that
        overlap with it."""
        largest, sizes = np.abs(errors), np.abs(errors)
        overlaps = np.diff(self.first) < self.bump.shape[1]
        largest[1:] = np.where(overlaps, np.maximum(largest[1:], sizes[:-1]), largest[1:])
        largest[:-1] = np.where(overlaps, np.maximum(largest[:-1], sizes[1:]), largest[:-1])
        return largest


def window_rows(recording: Recording, names: Sequence[str], variables: Sequence[str]) -> dict[str, ShortWindows]:
    """Return short windows for the equations of `variables`, which are states; `names` (V,) are symbols of states and
    inputs.

    Windows are as long as possible, but in enough windows linear interpolation between rows must give the same result
    as cubic interpolation, within the noise. To estimate the noise, rows are predicted from their neighbours. The
    result is empty if trajectories are too short for windows.
    """
    measured = measured_rows_of(recording, names)
    noise = measured.noise.copy()
    for place in np.flatnonzero(noise > 0.0).tolist():
        signals = [
            Signal(measured.times[start:end], measured.values[place, start:end].copy())
            for start, end in measured.ranges
        ]
        noise[place] = estimate_value_noise(*predict_left_out(signals))
    measured = replace(measured, smoothed=measured.values, noise=noise)
    longest, half = None, (_CUBIC + 1) // 2
    widest = max(end - start for start, end in measured.ranges) // SETTINGS.sparse.windows_in_width
    while half <= widest and (wider := _short_windows(measured, 0, half)) is not None:
        if longest is not None and not _is_resolved(wider):
            break
        longest, half = half, math.ceil(half * _WIDER)
    targets = {
        variable: names.index(recording.state_symbols[recording.states.index(variable)]) for variable in variables
    }
    rows = {} if longest is None else {name: _short_windows(measured, at, longest) for name, at in targets.items()}
    return {name: windows for name, windows in rows.items() if windows is not None}


def _is_resolved(rows: ShortWindows) -> bool:
    measured = rows.measured
    differences = window_integrals(rows.first, rows.slope - rows.coarse[1], measured.values)
    own = np.outer(measured.noise**2, (rows.slope**2).sum(axis=1))
    pairs = zip(differences, own, strict=True)
    shares = np.array([np.mean(rows.widen(difference) ** 2 <= variance) for difference, variance in pairs])
    return bool((shares[measured.noise > 0.0] >= _RESOLVED).all())


def _short_windows(measured: MeasuredRows, target: int, half: int) -> ShortWindows | None:
    """Return windows; each begins in the middle of the previous window. None if there are too few windows."""
    length = 2 * half + 1
    every = np.array(
        [row for start, end in measured.ranges for row in range(start, end - length + 1, half)], dtype=np.int64
    )
    if len(every) < SETTINGS.sparse.windows_in_width:
        return None
    first = every[thinned_places(len(every), SETTINGS.rows.most)]
    times = measured.times[first[:, None] + np.arange(length)]
    share = min(0.5 * len(every) / len(first), 1.0)
    return windows_of(ShortWindows, measured, target, first, _weights(times, _CUBIC), share, _weights(times, _LINE))


def _weights(times: FloatArray, order: int) -> tuple[FloatArray, FloatArray]:
    """Return weights (W, L) of rows at `times` (W, L) for integrals with the test function, and with its slope.

    Between two rows, the integrated function is approximated by the polynomial of this order through the nearest rows
    of the window.
    """
    nodes, shares = np.polynomial.legendre.leggauss(_SMOOTHNESS + _CUBIC)
    middle, width = 0.5 * (times[:, :1] + times[:, -1:]), 0.5 * (times[:, -1:] - times[:, :1])
    bump, slope = np.zeros_like(times), np.zeros_like(times)
    exponent, length = _SMOOTHNESS, times.shape[1]
    for gap in range(length - 1):
        low = min(max(gap - order // 2, 0), length - order - 1)
        near = times[:, low : low + order + 1]
        size = 0.5 * (times[:, gap + 1] - times[:, gap])[:, None]
        places = times[:, gap : gap + 1] + size * (nodes + 1.0)
        unit = (places - middle) / width
        inside = np.maximum(1.0 - unit * unit, 0.0)
        value = inside**exponent * shares * size
        change = -2.0 * exponent * unit * inside ** (exponent - 1) / width * shares * size
        for place in range(order + 1):
            basis = np.ones_like(places)
            for neighbour in range(order + 1):
                if neighbour != place:
                    basis = basis * (places - near[:, neighbour, None]) / (near[:, place] - near[:, neighbour])[:, None]
            bump[:, low + place] += (value * basis).sum(axis=1)
            slope[:, low + place] += (change * basis).sum(axis=1)
    return bump, slope


# ------------------------------------------------------------------------------------------------- the search


@dataclass(frozen=True, eq=False)
class UnknownEquation:
    """The rows of one equation, and its allowed variables (indices) and operators (codes)."""

    rows: RegressionRows
    columns: Sequence[int]
    operators: Collection[int]

    def allows(self, atom: Atom) -> bool:
        """Tell whether a term has only allowed variables and operators."""
        others = set(range(len(self.rows.inputs))) - set(self.columns)
        operators = set(operators_in(atom.shape.expression(atom.constant)))
        return operators <= set(self.operators) and not any(map(atom.depends_on, others))

    def polynomials(self, degrees: Sequence[int]) -> list[list[Product]]:
        """Return the products of a polynomial of each of these degrees, if there are enough rows for it."""
        return [terms for terms, _ in polynomial_libraries(self.columns, self.rows.independent, degrees)]

    def is_law(self, found: Sum | None) -> bool:
        """Tell whether the residuals of a sum are as small as their errors."""
        return found is not None and found.excess <= self.rows.largest_excess


@dataclass(frozen=True, eq=False)
class _FoundSum:
    """A sum without its regression: it can be sent to other machines. `is_law`: its residuals are like its errors."""

    terms: tuple[Term, ...]
    coefficients: tuple[float, ...]
    nats: float
    excess: float
    is_law: bool

    @classmethod
    def of(cls, equation: UnknownEquation, found: Sum) -> "_FoundSum":
        terms = tuple(map(Term.of, found.atoms))
        return cls(terms, tuple(found.coefficients), found.nats, found.excess, equation.is_law(found))

    def over(self, rows: RegressionRows) -> Sum:
        """Return the sum of a regression that has only its terms. The weights of its rows are unknown."""
        regression = SparseRegression(rows, [term.over(rows.inputs) for term in self.terms])
        assessment = Assessment(np.full(len(rows.sides), np.nan), math.nan, self.excess)
        return Sum(regression, tuple(range(len(self.terms))), [*self.coefficients], self.nats, assessment)


@dataclass(frozen=True, eq=False)
class _SentEquation:
    """An unknown equation without the data that equations share, `shared` is the place of these data.

    Derivatives have left sides and standard errors, `rates`; short windows have the variable `target` and a half width
    `half`. In the second search, `found` is the sum of the first one, and `others` are functions of other laws.
    """

    number: int
    shared: int
    columns: tuple[int, ...]
    operators: frozenset[int]
    rates: tuple[FloatArray, FloatArray] | None
    target: int
    half: int
    found: _FoundSum | None = None
    others: tuple[Term, ...] = ()


_Item = TypeVar("_Item")
_Outcome = TypeVar("_Outcome")

_Shared = tuple[MeasuredRows | FloatArray, ...]
"""Measured rows of short windows, or the values (V, N) of the variables at derivatives, of one or more equations."""


class _Equations:
    """The unknown equations of a system by number, in this process or built from the data that were sent."""

    def __init__(self, shared: _Shared, known: Sequence[UnknownEquation] = ()) -> None:
        self._shared, self._known = shared, dict(enumerate(known))

    def get(self, sent: _SentEquation) -> UnknownEquation:
        """Return an equation; its rows are built once, so that they keep the values of terms."""
        if sent.number not in self._known:
            shared = self._shared[sent.shared]
            rows: RegressionRows | None
            if isinstance(shared, MeasuredRows):
                rows = _short_windows(shared, sent.target, sent.half)
            else:
                assert sent.rates is not None
                rows = RateRows(shared, *sent.rates)
            assert rows is not None, "there are windows"
            return self._known.setdefault(sent.number, UnknownEquation(rows, sent.columns, sent.operators))
        return self._known[sent.number]


def _sent(equations: Sequence[UnknownEquation]) -> tuple[_Shared, list[_SentEquation]]:
    """Return the data that equations share, and the equations without them."""
    shared: list[MeasuredRows | FloatArray] = []
    sent = []
    for number, equation in enumerate(equations):
        rows, own = equation.rows, (tuple(equation.columns), frozenset(equation.operators))
        if isinstance(rows, ShortWindows):
            place = next((place for place, known in enumerate(shared) if known is rows.measured), len(shared))
            shared += [rows.measured] if place == len(shared) else []
            sent.append(_SentEquation(number, place, *own, None, rows.target, rows.bump.shape[1] // 2))
        else:
            places = (place for place, known in enumerate(shared) if _is_equal(known, rows.inputs))
            place = next(places, len(shared))
            shared += [rows.inputs] if place == len(shared) else []
            sent.append(_SentEquation(number, place, *own, (rows.sides, rows.side_errors), 0, 0))
    return tuple(shared), sent


def _is_equal(known: MeasuredRows | FloatArray, inputs: FloatArray) -> bool:
    return not isinstance(known, MeasuredRows) and np.array_equal(known, inputs)


@dataclass(frozen=True, eq=False)
class _Proposals:
    """The `best` sum of an equation, and sums with one more function: `longer` begin with the best sum, `others` with a
    constant or a short polynomial. Functions are compared on the trusted rows."""

    best: _FoundSum
    longer: tuple[_FoundSum, ...] = ()
    others: tuple[_FoundSum, ...] = ()

    def starts(self, *, are_together: bool) -> list[tuple[tuple[Term, ...], ...]]:
        """Return the terms of all sums with a function, the shortest sum first; each alone, or all together."""
        ordered = sorted((*self.longer, *self.others), key=lambda fit: fit.nats)
        terms = tuple(fit.terms for fit in ordered)
        return ([terms] if terms else []) if are_together else [(one,) for one in terms]


@dataclass(frozen=True, eq=False)
class _Extension:
    """An equation with its best sum (`sent.found`), and the terms of sums with a function, from which longer sums are
    searched."""

    sent: _SentEquation
    starts: tuple[tuple[Term, ...], ...]


def _begin(equations: _Equations, sent: _SentEquation) -> _Proposals | None:
    """Return the shortest polynomial of low degree, and sums with a function.

    If rows are precise, wrong sums have much larger residuals. So the search then ends with the first law.
    """
    equation = equations.get(sent)
    rows, best, sizes = equation.rows, None, equation.polynomials(_DEGREES[:_LOW])
    for terms in sizes:
        best = shortest([best, _select_products(rows, terms)])
        if rows.is_precise and equation.is_law(best):
            break
    if best is None:
        return None
    found = _FoundSum.of(equation, best)
    if rows.is_precise and found.is_law:
        return _Proposals(found)
    trusted = rows.trusted
    products: list[list[Product]] = [[()], *sizes[: 1 + rows.is_precise]]
    starts = [[atom.over(trusted.inputs) for atom in best.atoms]]
    starts += [[*product_atoms(trusted.inputs, terms)] for terms in products]
    longer, *others = _add_function(equation, trusted, starts)
    return _Proposals(found, longer, tuple(chain(*others)))


def _propose(equations: _Equations, sent: _SentEquation) -> tuple[_FoundSum, ...]:
    """Return the best sum, `sent.found`, with one more function."""
    assert sent.found is not None
    equation = equations.get(sent)
    trusted = equation.rows.trusted
    return _add_function(equation, trusted, [[term.over(trusted.inputs) for term in sent.found.terms]])[0]


def _add_function(
    equation: UnknownEquation, trusted: RegressionRows, starts: Sequence[Sequence[Atom]]
) -> list[tuple[_FoundSum, ...]]:
    """Return for each of the sums `starts` the best sums with one more product with a function; inner constants are
    fitted."""
    shapes = products_with_functions(trusted.inputs, equation.columns, equation.operators)
    most = len(trusted.sides) / SETTINGS.sparse.rows_per_term
    short = [place for place, atoms in enumerate(starts) if len(atoms) <= most]
    further_terms = rank_functions(trusted, [starts[place] for place in short], shapes, SETTINGS.effort.beam)
    fits: list[tuple[_FoundSum, ...]] = [() for _ in starts]
    for place, further in zip(short, further_terms, strict=True):
        sums = filter(None, (fit_sum(trusted, [*starts[place], atom]) for atom in further))
        best = map(fit_inner_constants, sorted(sums, key=lambda fit: fit.nats)[:_KEPT])
        fits[place] = tuple(_FoundSum.of(equation, fit) for fit in best)
    return fits


def _extend(equations: _Equations, extension: _Extension) -> _FoundSum | None:
    """Return the shortest sum of products of a library, of the functions of the best sum, and of one more function."""
    equation, best = equations.get(extension.sent), extension.sent.found
    assert best is not None
    rows, candidate = equation.rows, None
    library = product_atoms(rows.inputs, equation.polynomials(_DEGREES[:_LOW])[-1])
    own = [term.over(rows.inputs) for term in best.terms if term.function is not None]
    for terms in extension.starts:
        atoms = [term.over(rows.inputs) for term in terms]
        plain = [atom for atom in atoms if atom.shape.function is None]
        candidate = shortest([candidate, _search_sum(rows, library, [*plain, *own, atoms[-1]])])
        if rows.is_precise and equation.is_law(candidate):
            break
    return None if candidate is None else _FoundSum.of(equation, candidate)


def _add_degrees(equations: _Equations, sent: _SentEquation) -> _FoundSum | None:
    """Return the shortest of the best sum and of polynomials of higher degrees; the search ends with the first law."""
    equation = equations.get(sent)
    before = best = None if sent.found is None else sent.found.over(equation.rows)
    for terms in equation.polynomials(_DEGREES)[_LOW:]:
        best = shortest([best, _select_products(equation.rows, terms)])
        if equation.is_law(best):
            break
    return sent.found if best is None or best is before else _FoundSum.of(equation, best)


def _select_products(rows: RegressionRows, terms: Sequence[Product]) -> Sum | None:
    """Return the shortest sum of these products."""
    regression = SparseRegression(rows, product_atoms(rows.inputs, terms))
    return regression.select_terms(range(len(terms)), 1.0 / rows.side_errors)


def _search_with_others(equations: _Equations, sent: _SentEquation) -> _FoundSum | None:
    """Return the shortest sum with functions of other laws."""
    equation = equations.get(sent)
    before = None if sent.found is None else sent.found.over(equation.rows)
    functions = [term.over(equation.rows.inputs) for term in sent.others]
    found = _add_functions_of_other_laws(equation, before, functions)
    return sent.found if found is None or found is before else _FoundSum.of(equation, found)


_BEGIN: Final[BatchFunction[_Equations, _SentEquation, _Proposals | None]] = BatchFunction(
    "laws among many variables", _Shared, _SentEquation, _Proposals | None, _begin, _Equations
)
_PROPOSE: Final[BatchFunction[_Equations, _SentEquation, tuple[_FoundSum, ...]]] = BatchFunction(
    "laws with one more function", _Shared, _SentEquation, tuple[_FoundSum, ...], _propose, _Equations
)
_EXTEND: Final[BatchFunction[_Equations, _Extension, _FoundSum | None]] = BatchFunction(
    "sums of products and functions", _Shared, _Extension, _FoundSum | None, _extend, _Equations
)
_ADD_DEGREES: Final[BatchFunction[_Equations, _SentEquation, _FoundSum | None]] = BatchFunction(
    "laws of higher degree", _Shared, _SentEquation, _FoundSum | None, _add_degrees, _Equations
)
_WITH_OTHERS: Final[BatchFunction[_Equations, _SentEquation, _FoundSum | None]] = BatchFunction(
    "laws with functions of other laws", _Shared, _SentEquation, _FoundSum | None, _search_with_others, _Equations
)


class _Search:
    """The search of the laws of all equations in step; a `spread` computes each step in batches."""

    def __init__(self, equations: Sequence[UnknownEquation], spread: Spread) -> None:
        self._equations, self._spread = equations, spread
        self._shared, self.sent = _sent(equations)
        self.sums: list[_FoundSum | None] = [None for _ in equations]

    def _map(
        self, function: BatchFunction[_Equations, _Item, _Outcome], items: Sequence[_Item]
    ) -> list[_Outcome | None]:
        context = partial(_Equations, self._shared, self._equations)
        return self._spread.map(function, context, items, parts=lambda: self._shared, is_long=True)

    def is_done(self, number: int) -> bool:
        """Tell whether the sum of an equation is the law for certain: its rows are precise."""
        found = self.sums[number]
        return found is not None and found.is_law and self._equations[number].rows.is_precise

    def _with_sum(self, number: int) -> _SentEquation:
        return replace(self.sent[number], found=self.sums[number])

    def search_alone(self) -> None:
        """Search each equation alone: polynomials of low degree, functions, and polynomials of higher degree.

        Functions are added to a sum one after another, as long as this makes the description shorter.
        """
        begun = dict(enumerate(self._map(_BEGIN, self.sent)))
        proposals = {number: found for number, found in begun.items() if found is not None}
        for number, proposed in proposals.items():
            self.sums[number] = proposed.best
        for added in range(SETTINGS.sparse.functions):
            proposals = {number: found for number, found in proposals.items() if not self.is_done(number)}
            if added:
                longer = self._map(_PROPOSE, [*map(self._with_sum, proposals)])
                pairs = zip(proposals.items(), longer, strict=True)
                proposals = {number: replace(found, longer=sums or ()) for (number, found), sums in pairs}
            extended = self._extend(proposals)
            proposals = {number: proposals[number] for number in extended}
            for number, longest in extended.items():
                self.sums[number] = longest
        precise = [number for number, equation in enumerate(self._equations) if equation.rows.is_precise]
        precise = [number for number in precise if not self.is_done(number)]
        for number, law in zip(precise, self._map(_ADD_DEGREES, [*map(self._with_sum, precise)]), strict=True):
            self.sums[number] = law

    def _extend(self, proposals: Mapping[int, _Proposals]) -> dict[int, _FoundSum]:
        """Return the shortest sums with one more function that are shorter than the sums before, by number of equation.

        The search of an equation with precise rows ends with the first law. So its sums are searched one after another.
        """
        extensions = [
            (number, _Extension(self._with_sum(number), starts))
            for number, found in proposals.items()
            for starts in found.starts(are_together=self._equations[number].rows.is_precise)
        ]
        best: dict[int, _FoundSum] = {}
        candidates = self._map(_EXTEND, [extension for _, extension in extensions])
        for (number, extension), candidate in zip(extensions, candidates, strict=True):
            before = best.get(number, extension.sent.found)
            assert before is not None
            needed = before.nats - (0.0 if number in best else log(float(SETTINGS.sparse.most_atoms)))
            if candidate is not None and candidate.nats < needed:
                best[number] = candidate
        return best

    def search_with_others(self) -> None:
        """Search with functions of the other equations' laws as further terms."""
        functions = [
            tuple(term for term in found.terms if term.function is not None)
            if found is not None and found.is_law
            else ()
            for found in self.sums
        ]
        again = [
            replace(self._with_sum(number), others=tuple(chain(*functions[:number], *functions[number + 1 :])))
            for number in range(len(self.sums))
            if not self.is_done(number)
        ]
        again = [one for one in again if one.others]
        for one, found in zip(again, self._map(_WITH_OTHERS, again), strict=True):
            self.sums[one.number] = found


def find_short_laws(
    equations: Mapping[str, UnknownEquation], spread: Spread | None = None
) -> dict[str, tuple[Law, ...]]:
    """Return the law of each state; empty if no short sum has residuals as small as their errors.

    `spread` computes equations in threads or on workers; None: one after another.
    """
    search = _Search(list(equations.values()), spread or Spread())
    search.search_alone()
    search.search_with_others()
    return {
        name: () if found is None or not found.is_law else (_law(found, equation.rows),)
        for (name, equation), found in zip(equations.items(), search.sums, strict=True)
    }


def _law(found: _FoundSum, rows: RegressionRows) -> Law:
    return Law(found.over(rows).program(), found.nats, found.excess, is_tested=True, is_of_rates=True)


def _search_sum(
    rows: RegressionRows, library: Sequence[Atom], start: Sequence[Atom], shared: frozenset[Atom] = frozenset()
) -> Sum | None:
    """Return the shortest sum of the products of a library and the functions of `start`; inner constants are fitted.

    The search has several start sums: they consist of these functions and the products of `start`, or of these
    functions and the products of the library up to each degree. The search is repeated as long as fitted inner
    constants shorten the description.
    """
    weights, best = 1.0 / rows.side_errors, None
    functions = [atom for atom in start if atom.shape.function is not None]
    factors = {atom.shape.factors for atom in start if atom.shape.function is None}
    while True:
        regression = SparseRegression(rows, (*library, *functions), shared)
        inside = [*range(len(library), len(regression.atoms))]
        starts = [[place for place, atom in enumerate(library) if atom.shape.factors in factors]]
        orders = [len(atom.shape.factors) for atom in library]
        starts += [[place for place, order in enumerate(orders) if order <= degree] for degree in {*orders} - {0}]
        found = shortest(regression.select_terms([*start, *inside], weights) for start in starts if [*start, *inside])
        found = None if found is None else fit_inner_constants(found)
        if found is None or (best is not None and not found.nats < best.nats - SETTINGS.selection.least_gain):
            return best
        best, shared = found, found.regression.shared
        functions = [atom for atom in found.atoms if atom.shape.function is not None]
        factors = {atom.shape.factors for atom in found.atoms if atom.shape.function is None}
        if not any(atom.shape.has_constant and atom not in shared for atom in functions):
            return best


def _add_functions_of_other_laws(equation: UnknownEquation, best: Sum | None, functions: Sequence[Atom]) -> Sum | None:
    """Return the shortest sum with functions of other states' laws as further terms. The inner constants of these
    functions are not changed."""
    rows = equation.rows
    for function in functions:
        if not equation.allows(function):
            continue
        atom = function.over(rows.inputs)
        own = () if best is None else best.atoms
        plain = [one for one in own if one.shape.function is None]
        for terms, _ in list(polynomial_libraries(equation.columns, rows.independent, _DEGREES[:2]))[-1:]:
            library = product_atoms(rows.inputs, terms)
            found = (_search_sum(rows, library, [*start, atom], frozenset([atom])) for start in (plain, own))
            best = shortest([best, *found])
    return best
