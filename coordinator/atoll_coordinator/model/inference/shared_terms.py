"""Terms that several equations share, fitted together: a flux that leaves one state and enters another (ADR 0058).

When brackets are expanded, each term has a factor and inner numbers: the factor of 2*u/(c + u) is 2, and c is an inner
number. Two terms of the same shape are one flux if their inner numbers are equal. If one factor is a simple multiple of
the other, the factors are the stoichiometry. `fit_shared_terms` decides which numbers become equal: near its minimum
the misfit is a quadratic form, so the increase of the misfit is known if two numbers are made equal. Decisions are made
one after another, as for simple numbers. The model is then fitted with all decisions, and used if its description is
shorter.

Doubtful: decisions are greedy and depend on the order of the terms. Terms are only compared after expansion. A known
equation, or an equation with bounds, must not be expanded, so it shares no terms.

Letters: P fitted constants.
"""

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from atoll_coordinator.model.constants.rounding import Estimates
from atoll_coordinator.model.description_length import structure_length
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.shooting.fit_result import bounded_covariance
from atoll_coordinator.model.shooting.system import Place, SharedNumber
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import Program, constant_places
from atoll_core.expression.writing.expansion import (
    Expansion,
    Role,
    Shape,
    raised_quotients,
    shape_of,
    terms_of,
    write_expansion,
)
from atoll_core.expression.writing.sums_of_products import Sum, UndefinedError

_ROUNDING: Final = 2.0**-50
"""Differences below this share of a constant are rounding errors."""


@dataclass(frozen=True, eq=False)
class SharedTermsFit:
    """A model whose equations share the `numbers` of these terms."""

    model: FittedModel
    terms: "tuple[Flux, ...]"
    numbers: list[SharedNumber]


def fit_shared_terms(comparison: ModelComparison, near: FittedModel, shown: Sequence[Program]) -> SharedTermsFit | None:
    """Return `shown` with brackets expanded and shared terms fitted together. None if this does not shorten the
    description.

    Equations that the user gave, or that have bounds, are not changed; nor are equations with a template.
    """
    if comparison.template.sides:
        return None  # a template says which parts are shared
    sums = _expand_equations(comparison, shown)
    expansions = [None if summands is None else write_expansion(summands) for summands in sums]
    common = _find_common_terms(expansions)
    if not common:
        return None
    programs = [
        expansion.program if expansion is not None else shown[equation] for equation, expansion in enumerate(expansions)
    ]
    free, unshared = comparison.fit_from(near, programs), comparison.fit_from(near, shown)
    if free is None or unshared is None:
        return None
    savings = {shape: _price_of_repetition(shape, sums) for shape in common}
    costs = [
        structure_length(expanded) - structure_length(program)
        for expanded, program in zip(programs, shown, strict=True)
    ]
    terms = _drop_costly_terms(_find_fluxes(comparison, free, common, savings), costs)
    if not terms:
        return None
    touched = {equation for term in terms for equation in term.multiples}
    chosen = [
        free.programs[equation] if equation in touched else unshared.programs[equation]
        for equation in range(len(shown))
    ]
    numbers = [number for term in terms for number in term.numbers]
    together = comparison.fit_from(free, chosen, shared=numbers)
    if together is None or together.nats - sum(term.saving for term in terms) >= unshared.nats:
        return None
    return SharedTermsFit(together, terms, numbers)


# ----------------------------------------------------------------------------------------------- terms and their places


@dataclass(frozen=True)
class _Occurrence:
    """A term of an equation: the place of its `factor` (None for a factor of one) and the places of its `inner`
    numbers.

    Each place has the sign of its constant. Inner numbers are in the order of their paths in the term. `layout` has
    these paths, and also the paths of numbers that the form of the term fixes at one or minus one.
    """

    equation: int
    factor: tuple[Place, float] | None
    inner: tuple[tuple[Place, float], ...]
    layout: Hashable


def _expand_equations(comparison: ModelComparison, shown: Sequence[Program]) -> list[Sum | None]:
    """Return the terms of each equation; None for equations that must not change.

    If another equation has a term of the shape n*u/(c + u), a term n/(c + u) is written as a sum of n and a multiple of
    n*u/(c + u).
    """
    sums = [_expand_equation(comparison, equation, program) for equation, program in enumerate(shown)]
    shapes = [{shape_of(monomial) for monomial, _ in summands or ()} for summands in sums]
    for equation, summands in enumerate(sums):
        others = set().union(*shapes[:equation], *shapes[equation + 1 :])
        sums[equation] = next(
            (raised_sum for shape, raised_sum in raised_quotients(summands or ()) if shape in others), summands
        )
    return sums


def _price_of_repetition(shape: Shape, sums: Sequence[Sum | None]) -> float:
    """Return the nats that are saved if a term occurs again with the same numbers. The repeated term then costs as
    little as the second use of a part within one equation.
    """
    monomials = (monomial for summands in sums for monomial, _ in summands or () if shape_of(monomial) == shape)
    expansion = write_expansion(((next(monomials), 1.0),))
    return 0.0 if expansion is None else structure_length(expansion.program) - SETTINGS.criterion.common


def _expand_equation(comparison: ModelComparison, equation: int, program: Program) -> Sum | None:
    """Return the terms of an equation. None if the equation must not change, or if it has too many terms."""
    if equation in comparison.fixed or comparison.restrictions(equation).bounds is not None:
        return None
    try:
        return terms_of(program)
    except UndefinedError:
        return None


def _find_common_terms(expansions: Sequence[Expansion | None]) -> dict[Shape, list[_Occurrence]]:
    """Return the terms that occur in at least two equations, by shape.

    Terms that occur several times in one equation are left out.
    """
    occurrences: dict[Shape, list[_Occurrence]] = {}
    for equation, expansion in enumerate(expansions):
        for shape, occurrence in _list_occurrences(equation, expansion) if expansion is not None else ():
            occurrences.setdefault(shape, []).append(occurrence)
    return {
        shape: alike
        for shape, alike in occurrences.items()
        if len(alike) > 1 and len({occurrence.equation for occurrence in alike}) == len(alike)
    }


def _list_occurrences(equation: int, expansion: Expansion) -> Iterator[tuple[Shape, _Occurrence]]:
    """Yield the terms of an equation that have a variable, with their shapes."""
    places = [(equation, node) for node in constant_places(expansion.program)]
    by_shape: dict[Shape, list[tuple[Role, Place]]] = {}
    for place, role in zip(places, expansion.roles, strict=True):
        by_shape.setdefault(role.shape, []).append((role, place))
    for shape, roles in by_shape.items():
        factors = [(place, role.sign) for role, place in roles if not role.is_inner]
        inside = sorted(((role.path, place, role.sign) for role, place in roles if role.is_inner))
        paths = tuple(path for path, _, _ in inside)
        units = frozenset((role.path, role.sign) for role in expansion.units if role.shape == shape)
        if shape and len(factors) < 2 and len({*paths}) == len(paths):
            inner = tuple((place, sign) for _, place, sign in inside)
            yield shape, _Occurrence(equation, factors[0] if factors else None, inner, (paths, units))


# ----------------------------------------------------------------------------------------------------- shared numbers


@dataclass(eq=False)
class _PlacedEstimates:
    """Fitted constants by place. Their `values` (P,) and their `covariance` (P, P) hold for the decisions made so
    far."""

    index: Mapping[Place, int]
    values: FloatArray
    covariance: FloatArray

    def value(self, place: Place) -> float:
        """Return the value of a constant."""
        return float(self.values[self.index[place]])

    def row(self, *parts: tuple[tuple[Place, float], float]) -> FloatArray:
        """Return the coefficients (P,) of a sum of constants, each with its sign, times a factor."""
        coefficients = np.zeros(len(self.values))
        for (place, sign), factor in parts:
            coefficients[self.index[place]] += sign * factor
        return coefficients

    def variance(self, row: FloatArray) -> float:
        """Return the variance of a sum of constants, at least the variance of rounding errors."""
        least = _ROUNDING * float(np.abs(row * self.values).max())
        return max(float(row @ self.covariance @ row), least * least, 1e-300)

    def with_zero_sum(self, row: FloatArray) -> tuple["_PlacedEstimates", float]:
        """Return the estimates under the condition that a sum of constants is zero, and the increase of the misfit in
        nats."""
        variance, away = self.variance(row), float(row @ self.values)
        column = self.covariance @ row
        values = self.values - column * (away / variance)
        covariance = self.covariance - np.outer(column, column) / variance
        return _PlacedEstimates(self.index, values, covariance), 0.5 * away * away / variance


@dataclass(eq=False)
class Flux:
    """Terms of this `shape` with the same inner numbers, each in a different equation.

    As a flux, they make the description about `nats` shorter; `saving` is the part of these nats that is saved because
    the flux is written only once. `reference` is the smallest factor. `ratios` has, by equation, the ratio of the
    term's factor to the reference; it has only ratios that are simple numbers.
    """

    shape: Shape
    terms: list[_Occurrence]
    nats: float = 0.0
    saving: float = 0.0
    reference: tuple[Place, float] | None = None
    direction: float = 1.0
    ratios: dict[int, float] = field(default_factory=dict)

    @property
    def alike(self) -> list[_Occurrence]:
        """The terms that share a number."""
        return [term for term in self.terms if term.inner or term.equation in self.ratios]

    @property
    def multiples(self) -> dict[int, float | None]:
        """The multiple of the flux in each equation; None if the factor is fitted separately."""
        equations = [term.equation for term in self.alike]
        return {one: self.ratios[one] * self.direction if one in self.ratios else None for one in equations}

    @property
    def numbers(self) -> list[SharedNumber]:
        """The fitted numbers that these terms share."""
        numbers: list[SharedNumber] = [
            tuple((term.inner[number][0], term.inner[number][1] * sign) for term in self.alike)
            for number, (_, sign) in enumerate(self.terms[0].inner)
        ]
        if self.reference is not None and self.ratios:
            sign = self.reference[1]
            factors = [(term.factor, self.ratios[term.equation]) for term in self.terms if term.equation in self.ratios]
            numbers.append(
                tuple((factor[0], factor[1] * sign * ratio) for factor, ratio in factors if factor is not None)
            )
        return numbers


def _find_fluxes(
    comparison: ModelComparison, free: FittedModel, common: Mapping[Shape, Sequence[_Occurrence]],
    savings: Mapping[Shape, float],
) -> list[Flux]:  # fmt: skip
    """Return the fluxes: terms that share numbers and factors according to the estimates of a fit."""
    system = free.fit.system
    index = {place: number for number, place in enumerate(comparison.places(system))}
    estimates = _PlacedEstimates(index, system.values, comparison.score.inflation(free) * bounded_covariance(free.fit))
    found: list[Flux] = []
    for shape, alike in common.items():
        estimates, fluxes = _group_equal_terms(estimates, shape, alike, comparison.score.constant_nats, savings[shape])
        for flux in fluxes:
            estimates = _decide_multiples(estimates, flux, comparison.score.constant_nats)
        found += [flux for flux in fluxes if len(flux.alike) > 1]
    return found


def _group_equal_terms(
    estimates: _PlacedEstimates, shape: Shape, alike: Sequence[_Occurrence], constant_nats: float, saving: float
) -> tuple[_PlacedEstimates, list[Flux]]:
    """Group terms of one shape into fluxes: their inner numbers become equal if this shortens the description."""
    fluxes: list[Flux] = []
    for term in alike:
        for flux in fluxes:
            trial, nats = estimates, saving if term.inner else 0.0
            if flux.terms[0].layout != term.layout:
                continue
            for reference, constant in zip(flux.terms[0].inner, term.inner, strict=True):
                trial, grown = trial.with_zero_sum(trial.row((reference, 1.0), (constant, -1.0)))
                nats += constant_nats - grown
            if nats > 0.0 or not term.inner:
                estimates, flux.nats = trial, flux.nats + nats
                flux.saving += saving if term.inner else 0.0
                flux.terms.append(term)
                break
        else:
            fluxes.append(Flux(shape, [term]))
    return estimates, fluxes


def _decide_multiples(estimates: _PlacedEstimates, flux: Flux, constant_nats: float) -> _PlacedEstimates:
    """Decide which factors are simple multiples of the smallest factor, store them in `flux`, and return the estimates
    under these decisions."""
    factors = {term.equation: term.factor for term in flux.terms if term.factor is not None}
    if len(factors) < 2:
        return estimates
    sizes = {equation: sign * estimates.value(place) for equation, (place, sign) in factors.items()}
    least = min(sizes, key=lambda equation: abs(sizes[equation]))
    reference = flux.reference = factors.pop(least)
    flux.direction = 1.0 if sizes[least] > 0.0 else -1.0
    for equation, factor in factors.items():
        ratio = _simple_ratio(estimates, reference, factor)
        if ratio is not None:
            estimates, grown = estimates.with_zero_sum(estimates.row((factor, 1.0), (reference, -ratio)))
            flux.nats += constant_nats - grown
            flux.ratios |= {least: 1.0, equation: ratio}
    return estimates


def _simple_ratio(
    estimates: _PlacedEstimates, base: tuple[Place, float], constant: tuple[Place, float]
) -> float | None:
    """Return the simple fraction that the data support as the ratio of the factor `constant` to `base`; None if there
    is no such fraction."""
    below, above = (sign * estimates.value(place) for place, sign in (base, constant))
    if below == 0.0:
        return None
    ratio = above / below
    variance = estimates.variance(estimates.row((constant, 1.0 / below), (base, -ratio / below)))
    number = Estimates(np.array([ratio]), np.array([[variance]])).accepted_numbers.get(0)
    denominators = SETTINGS.inference.denominators
    is_simple = number is not None and any((number * denominator).is_integer() for denominator in denominators)
    return number if is_simple else None


def _drop_costly_terms(terms: Sequence[Flux], costs: Sequence[float]) -> tuple[Flux, ...]:
    """Return the fluxes that gain more nats than the `costs` of expanding their equations."""

    def gain(terms: Sequence[Flux]) -> float:
        expanded = {equation for term in terms for equation in term.multiples}
        return sum(term.nats for term in terms) - sum(costs[equation] for equation in sorted(expanded))

    chosen = tuple(terms)
    while chosen:
        fewer = max((chosen[:place] + chosen[place + 1 :] for place in range(len(chosen))), key=gain)
        if gain(fewer) <= gain(chosen):
            break
        chosen = fewer
    return chosen if gain(chosen) > 0.0 else ()
