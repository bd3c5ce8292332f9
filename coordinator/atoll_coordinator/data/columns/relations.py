"""Columns that determine each other: equal ones, multiples, totals, sums that stay constant. Pure.

Each column is compared, by least squares, with those before it (modified Gram-Schmidt, twice), whose coefficients
follow from those of the basis. Whatever equation is found with such columns, others say the same.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal

import numpy as np

from atoll_coordinator.data.columns.finding import Columns, Finding, listed
from atoll_coordinator.data.columns.sums import dot, mean, roughness, sign_changes, variance
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

LIMITS = SETTINGS.columns


@dataclass(frozen=True)
class Relation:
    """``name = constant + sum of coefficient * column``, exact but for rounding, or up to noise.

    `residual` is its standard deviation, as a share of that of the column.
    """

    name: str
    coefficients: Mapping[str, float]
    constant: float
    is_exact: bool
    residual: float

    def solved_for(self, name: str) -> "Relation":
        """Return the same relation for another of its columns."""
        if name == self.name:
            return self
        share = self.coefficients[name]
        others = {other: -value / share for other, value in self.coefficients.items() if other != name}
        rearranged = {**others, self.name: 1.0 / share}
        return Relation(name, rearranged, -self.constant / share, self.is_exact, self.residual)

    @property
    def columns(self) -> tuple[str, ...]:
        """All columns that it is about."""
        return (*self.coefficients, self.name)


def check_relations(columns: Columns) -> Iterator[Finding]:
    """Yield a finding for each column that others determine.

    A state that is a multiple or a total of others, to within rounding, is not sought: nothing is lost. With a constant
    (a sum that stays 1, degrees beside kelvin) something is conserved, and each column has an equation.
    """
    left: list[str] = []
    for relation in linear_relations(columns):
        chosen = _subject(relation, left)
        is_made = relation.is_exact and chosen.constant == 0.0
        if is_made and columns.may_leave_out(chosen.name) and len(columns.roles.states) - len(left) > 1:
            left.append(chosen.name)
            yield _left_out(chosen, columns)
        else:
            yield _named(relation if chosen.constant else chosen, columns, left)


def linear_relations(columns: Columns) -> list[Relation]:
    """Return what determines columns, each by those before it."""
    roles = columns.roles
    names = [name for name in roles.variables if name in columns.values and name != roles.target]
    if len(names) > LIMITS.most_compared or (columns.roles.order == 2 and len(names) < 2):
        return []
    rows = np.flatnonzero(np.logical_and.reduce([np.isfinite(columns.whole[name]) for name in names] or [np.zeros(0)]))
    some = rows[:: -(-len(rows) // LIMITS.most_rows) or 1]
    values = {name: columns.whole[name][some] for name in names}
    every = {name: columns.whole[name][rows] for name in names}
    fit = _Basis()
    relations: list[Relation] = []
    for name in names:
        spread = variance(values[name])
        if len(rows) <= len(fit.names) + LIMITS.few_values or not spread > 0.0:
            continue
        found = fit.relation(name, values, every, math.sqrt(spread))
        if found is None:
            fit.add(name, values[name])
        else:
            relations.append(found)
    return relations


class _Basis:
    """Orthonormal columns, and how each is made of columns of the table, all about their means."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self._units: list[FloatArray] = []
        self._makings: list[list[float]] = []

    def add(self, name: str, values: FloatArray) -> None:
        """Take a column into the basis."""
        shares, rest = self._projected(values)
        size = math.sqrt(dot(rest, rest))
        making = [-sum(share * own[place] for share, own in zip(shares, self._makings, strict=True))
                  for place in range(len(self.names))]  # fmt: skip
        self.names.append(name)
        self._units.append(rest / size)
        self._makings = [[*own, 0.0] for own in self._makings] + [[entry / size for entry in (*making, 1.0)]]

    def _projected(self, values: FloatArray) -> tuple[list[float], FloatArray]:
        """Return the share of each unit in the values, and what is left of them."""
        shares, rest = [0.0] * len(self._units), values - mean(values)
        for _ in range(2):  # what rounding leaves the first time is taken off the second
            for place, unit in enumerate(self._units):
                share = dot(unit, rest)
                shares[place] += share
                rest = rest - share * unit
        return shares, rest

    def relation(
        self, name: str, values: Mapping[str, FloatArray], every: Mapping[str, FloatArray], deviation: float
    ) -> Relation | None:
        """Return how a column is made of those of the basis, None where it is not.

        `values` are those of some rows, `every` those of all, in which an exact relation holds.
        """
        shares, rest = self._projected(values[name])
        residual = math.sqrt(variance(rest)) / deviation
        if not self.names or residual > LIMITS.alike:
            return None
        coefficients = {
            other: sum(share * own[place] for share, own in zip(shares, self._makings, strict=True))
            for place, other in enumerate(self.names)
        }
        return _exact(name, coefficients, values, every, deviation) or _noisy(
            name, coefficients, values, deviation, rest
        )


def _exact(
    name: str,
    coefficients: Mapping[str, float],
    values: Mapping[str, FloatArray],
    every: Mapping[str, FloatArray],
    deviation: float,
) -> Relation | None:
    """Return the relation if it holds in every row to within rounding: of arithmetic, or of what was written."""
    least = SETTINGS.common.negligible * deviation
    for terms in (_without_small(coefficients, values, least) or coefficients, coefficients):
        steps = [abs(factor) * _step(values[other]) for other, factor in terms.items()]
        written = 2.0 * (_step(values[name]) + sum(steps))
        tolerance = written if written <= least else SETTINGS.interpolation.smallest_noise * deviation
        rest = every[name] - _combined(terms, every)
        constant = mean(values[name] - _combined(terms, values))
        if float(np.max(np.abs(rest - constant))) <= tolerance:
            sizes = [abs(mean(values[other])) / math.sqrt(variance(values[other])) for other in (*terms, name)]
            is_zero = abs(constant) <= tolerance * (1.0 + max(sizes))
            return Relation(name, terms, 0.0 if is_zero else constant, True, 0.0)
    return None


def _noisy(
    name: str, coefficients: Mapping[str, float], values: Mapping[str, FloatArray], deviation: float, rest: FloatArray
) -> Relation | None:
    """Return the relation if what it leaves is small and without a pattern from row to row."""
    rows, left = len(rest), math.sqrt(variance(rest))
    least = 1.0 - LIMITS.significant / math.sqrt(rows)
    is_white = min(roughness([rest]), 2.0 * sign_changes(rest)) > least
    if rows < LIMITS.rows_per_column * (len(coefficients) + 1) or not is_white:
        return None
    error = LIMITS.significant * left / math.sqrt(rows)
    kept = _without_small(coefficients, values, max(error, SETTINGS.common.negligible * deviation))
    if not kept:
        return None
    constant = mean(values[name] - _combined(kept, values))
    sizes = [mean(values[other]) ** 2 / variance(values[other]) for other in kept]
    is_zero = abs(constant) <= error * math.sqrt(1.0 + sum(sizes))
    return Relation(name, kept, 0.0 if is_zero else constant, False, left / deviation)


def _without_small(
    coefficients: Mapping[str, float], values: Mapping[str, FloatArray], least: float
) -> dict[str, float]:
    return {
        other: factor
        for other, factor in coefficients.items()
        if abs(factor) * math.sqrt(variance(values[other])) > least
    }


def _combined(coefficients: Mapping[str, float], values: Mapping[str, FloatArray]) -> FloatArray:
    total = np.zeros(len(next(iter(values.values()))))
    for other, factor in coefficients.items():
        total = total + factor * values[other]
    return total


def _step(values: FloatArray) -> float:
    """Return the step in which the largest values of a column were written down."""
    some = values[:: max(1, len(values) // LIMITS.digits_read)]
    largest = float(np.max(np.abs(values)))
    numbers = [Decimal(repr(value)).normalize() for value in some.tolist() if value != 0.0]
    digits = max((len(number.as_tuple().digits) for number in numbers), default=1)
    place = min((int(number.as_tuple().exponent) for number in numbers), default=0)
    by_digits = 10.0 ** (Decimal(repr(largest)).adjusted() + 1 - digits) if largest else 0.0
    if 0.0 < largest < float(np.finfo(np.float32).max) and (values.astype(np.float32) == values).all():
        by_digits = max(by_digits, float(np.spacing(np.float32(largest))))
    return max(min(10.0**place, largest), by_digits, 4.0 * float(np.spacing(largest)))


def _subject(relation: Relation, left: Sequence[str]) -> Relation:
    """Return the relation for the column that is the sum of the others, as a total is, else as it was found."""
    if any(name in left for name in relation.columns):
        return relation
    forms = [relation.solved_for(name) for name in reversed(relation.columns)]
    return next((form for form in forms if all(value > 0.0 for value in form.coefficients.values())), relation)


def _left_out(relation: Relation, columns: Columns) -> Finding:
    name = relation.name
    return Finding(
        f"'{name}' is {_text(relation)} in every row, so that it adds nothing but other ways to write each equation",
        f"no equation is sought for it (--states {listed(columns.roles.states)} keeps it)",
        left_out=(name,),
    )


def _named(relation: Relation, columns: Columns, left: Sequence[str]) -> Finding:
    """Return the finding of a relation that is not acted on."""
    how = "in every row" if relation.is_exact else f"up to noise ({100.0 * relation.residual:.2g} % of {relation.name})"
    if relation.constant:
        ones = {name: -value for name, value in relation.coefficients.items()} | {relation.name: 1.0}
        least = min(abs(value) for value in ones.values())
        sign = 1.0 if max(ones.values()) > 0.0 and relation.constant > 0.0 else -1.0
        ones = {name: sign * value / least for name, value in ones.items()}
        digits = 4 if relation.is_exact else 2
        what = f"{_sum(ones, relation.is_exact)} stays {sign * relation.constant / least:.{digits}g} {how}"
    else:
        what = f"'{relation.name}' is {_text(relation)} {how}"
    states = [name for name in columns.roles.states if name not in left and name != relation.name]
    found = f"{what}, so that each equation can be written in several ways"
    if relation.name in columns.roles.states and states:
        return Finding(found, f"to do without '{relation.name}', add --states {listed(states)}")
    return Finding(found, f"leave '{relation.name}' out of --inputs if it is not wanted")


def _text(relation: Relation) -> str:
    return _sum(relation.coefficients, relation.is_exact)


def _sum(coefficients: Mapping[str, float], is_exact: bool) -> str:
    """Return a sum of columns as people write it, what is added before what is taken off."""
    digits, text = 4 if is_exact else 2, ""
    for name, value in sorted(coefficients.items(), key=lambda pair: pair[1] < 0.0):
        size = f"{abs(value):.{digits}g}"
        term = name if size == "1" else f"{size}*{name}"
        sign = " - " if value < 0.0 else " + "
        text += f"{sign}{term}" if text else f"-{term}" if value < 0.0 else term
    return text
