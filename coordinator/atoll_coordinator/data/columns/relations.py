"""Columns that determine each other: equal ones, multiples, totals, sums that stay constant. Pure.

Each column is compared, by least squares, with the columns before it (modified Gram-Schmidt, twice), whose coefficients
follow from the coefficients of the basis. Any equation found with such columns can be written in several ways.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Final

import numpy as np

from atoll_coordinator.data.columns.finding import (
    ExaminedColumns,
    Finding,
    dot,
    listed,
    mean,
    roughness,
    upper_median,
    variance,
)
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

LIMITS = SETTINGS.columns
_MOST_COLUMNS: Final = 100
"""Most columns that are compared by least squares: time grows with the square of their number."""
_ROWS_PER_COLUMN: Final = 10
"""Fewest rows for each column of a relation that holds up to noise: with fewer, patterns in residuals are not seen."""
Values = Mapping[str, FloatArray]


@dataclass(frozen=True)
class Relation:
    """``name = constant + sum of coefficient * column``, exact except for rounding, or up to noise.

    `residual` is its standard deviation, as a share of the standard deviation of the column.
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
        """All columns of the relation."""
        return (*self.coefficients, self.name)


def check_relations(columns: ExaminedColumns) -> Iterator[Finding]:
    """Yield a finding for each column that others determine.

    A state that is a multiple or a total of others, to within rounding, is not sought: nothing is lost. With a constant
    (a sum that stays 1, degrees Celsius and kelvin) something is conserved, and each column has an equation.
    """
    left_out: list[str] = []
    states = columns.roles.states
    for relation in linear_relations(columns):
        total = relation
        if not any(name in left_out for name in relation.columns):  # the column that is the sum of the others
            forms = [relation.solved_for(name) for name in reversed(relation.columns)]
            sums = (form for form in forms if all(value > 0.0 for value in form.coefficients.values()))
            total = next(sums, relation)
        is_redundant = relation.is_exact and total.constant == 0.0
        if is_redundant and columns.may_leave_out(total.name) and len(states) - len(left_out) > 1:
            left_out.append(total.name)
            yield Finding(
                f"'{total.name}' is {_sum(total.coefficients, total.is_exact)} in every row, so that it adds nothing "
                "but other ways to write each equation",
                f"no equation is sought for it (--states {listed(states)} keeps it)",
                left_out=(total.name,),
            )
        else:
            yield _remark(relation if total.constant else total, states, left_out)


def linear_relations(columns: ExaminedColumns) -> list[Relation]:
    """Return the relations that determine columns, each by the columns before it."""
    roles = columns.roles
    names = [name for name in roles.variables if name in columns.values and name != roles.target]
    if len(names) > _MOST_COLUMNS or (columns.roles.order == 2 and len(names) < 2):
        return []
    rows = np.flatnonzero(np.logical_and.reduce([np.isfinite(columns.whole[name]) for name in names] or [np.zeros(0)]))
    some = rows[:: -(-len(rows) // SETTINGS.common.most_rows) or 1]
    sampled = {name: columns.whole[name][some] for name in names}
    whole = {name: columns.whole[name][rows] for name in names}
    basis = _Basis()
    relations: list[Relation] = []
    for name in names:
        spread = variance(sampled[name])
        if len(rows) <= len(basis.names) + SETTINGS.common.few_values or not spread > 0.0:
            continue
        found = basis.relation(name, sampled, whole, math.sqrt(spread))
        if found is None:
            basis.add(name, sampled[name])
        else:
            relations.append(found)
    return relations


class _Basis:
    """Orthonormal columns, and their coefficients in columns of the table, all about their means."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self._units: list[FloatArray] = []
        self._coefficients: list[list[float]] = []

    def add(self, name: str, values: FloatArray) -> None:
        shares, rest = self._projected(values)
        size = math.sqrt(dot(rest, rest))
        own = [-value for value in self._combined(shares)]
        self.names.append(name)
        self._units.append(rest / size)
        self._coefficients = [[*row, 0.0] for row in self._coefficients] + [[entry / size for entry in (*own, 1.0)]]

    def _projected(self, values: FloatArray) -> tuple[list[float], FloatArray]:
        """Return the share of each unit in the values, and the residuals."""
        shares, rest = [0.0] * len(self._units), values - mean(values)
        for _ in range(2):  # the second time removes the rounding errors of the first
            for place, unit in enumerate(self._units):
                share = dot(unit, rest)
                shares[place] += share
                rest = rest - share * unit
        return shares, rest

    def _combined(self, shares: Sequence[float]) -> list[float]:
        return [
            sum(share * row[place] for share, row in zip(shares, self._coefficients, strict=True))
            for place in range(len(self.names))
        ]

    def relation(self, name: str, sampled: Values, whole: Values, deviation: float) -> Relation | None:
        """Return how a column depends on the columns of the basis, None where it does not.

        `sampled` are the values of some rows, `whole` the values of all rows, in which an exact relation holds.
        """
        shares, rest = self._projected(sampled[name])
        if not self.names or math.sqrt(variance(rest)) / deviation > LIMITS.alike:
            return None
        coefficients = dict(zip(self.names, self._combined(shares), strict=True))
        exact = _exact(name, coefficients, sampled, whole, deviation)
        return exact or _noisy(name, coefficients, sampled, deviation, rest)


def _exact(
    name: str, coefficients: Mapping[str, float], sampled: Values, whole: Values, deviation: float
) -> Relation | None:
    """Return the relation if it holds in every row to within rounding: of arithmetic, or of the written digits."""
    least = SETTINGS.common.negligible * deviation
    for terms in (_without_small(coefficients, sampled, least) or coefficients, coefficients):
        steps = [abs(factor) * _step(sampled[other]) for other, factor in terms.items()]
        written = 2.0 * (_step(sampled[name]) + sum(steps))
        tolerance = written if written <= least else SETTINGS.smoothing.smallest_noise * deviation
        rest = whole[name] - _weighted_sum(terms, whole)
        constant = mean(sampled[name] - _weighted_sum(terms, sampled))
        if float(np.max(np.abs(rest - constant))) <= tolerance:
            sizes = [abs(mean(sampled[other])) / math.sqrt(variance(sampled[other])) for other in (*terms, name)]
            is_zero = abs(constant) <= tolerance * (1.0 + max(sizes))
            return Relation(name, terms, 0.0 if is_zero else constant, True, 0.0)
    return None


def _noisy(
    name: str, coefficients: Mapping[str, float], sampled: Values, deviation: float, rest: FloatArray
) -> Relation | None:
    """Return the relation if its residuals are small and without a pattern from row to row."""
    rows, size = len(rest), math.sqrt(variance(rest))
    least = 1.0 - SETTINGS.common.significant / math.sqrt(rows)
    above = rest > upper_median(
        rest
    )  # few rows far out, as at the begin of a motion, decide a mean square, but not this
    sign_changes = int(np.count_nonzero(above[1:] != above[:-1])) / max(1, rows - 1)
    is_white = min(roughness([rest]), 2.0 * sign_changes) > least
    if rows < _ROWS_PER_COLUMN * (len(coefficients) + 1) or not is_white:
        return None
    error = SETTINGS.common.significant * size / math.sqrt(rows)
    kept = _without_small(coefficients, sampled, max(error, SETTINGS.common.negligible * deviation))
    if not kept:
        return None
    constant = mean(sampled[name] - _weighted_sum(kept, sampled))
    sizes = [mean(sampled[other]) ** 2 / variance(sampled[other]) for other in kept]
    is_zero = abs(constant) <= error * math.sqrt(1.0 + sum(sizes))
    return Relation(name, kept, 0.0 if is_zero else constant, False, size / deviation)


def _without_small(coefficients: Mapping[str, float], values: Values, least: float) -> dict[str, float]:
    return {
        name: factor for name, factor in coefficients.items() if abs(factor) * math.sqrt(variance(values[name])) > least
    }


def _weighted_sum(coefficients: Mapping[str, float], values: Values) -> FloatArray:
    total = np.zeros(len(next(iter(values.values()))))
    for name, factor in coefficients.items():
        total = total + factor * values[name]
    return total


def _step(values: FloatArray) -> float:
    """Return the step in which the largest values of a column were written down."""
    some = values[:: max(1, len(values) // LIMITS.sample)]
    largest = float(np.max(np.abs(values)))
    numbers = [Decimal(repr(value)).normalize() for value in some.tolist() if value != 0.0]
    digits = max((len(number.as_tuple().digits) for number in numbers), default=1)
    place = min((int(number.as_tuple().exponent) for number in numbers), default=0)
    by_digits = 10.0 ** (Decimal(repr(largest)).adjusted() + 1 - digits) if largest else 0.0
    if 0.0 < largest < float(np.finfo(np.float32).max) and (values.astype(np.float32) == values).all():
        by_digits = max(by_digits, float(np.spacing(np.float32(largest))))
    return max(min(10.0**place, largest), by_digits, 4.0 * float(np.spacing(largest)))


def _remark(relation: Relation, states: Sequence[str], left_out: Sequence[str]) -> Finding:
    how = "in every row" if relation.is_exact else f"up to noise ({100.0 * relation.residual:.2g} % of {relation.name})"
    if relation.constant:
        ones = {name: -value for name, value in relation.coefficients.items()} | {relation.name: 1.0}
        least = min(abs(value) for value in ones.values())
        sign = 1.0 if max(ones.values()) > 0.0 and relation.constant > 0.0 else -1.0
        ones = {name: sign * value / least for name, value in ones.items()}
        digits = 4 if relation.is_exact else 2
        what = f"{_sum(ones, relation.is_exact)} stays {sign * relation.constant / least:.{digits}g} {how}"
    else:
        what = f"'{relation.name}' is {_sum(relation.coefficients, relation.is_exact)} {how}"
    others = [name for name in states if name not in left_out and name != relation.name]
    found = f"{what}, so that each equation can be written in several ways"
    if relation.name in states and others:
        return Finding(found, f"to do without '{relation.name}', add --states {listed(others)}")
    return Finding(found, f"leave '{relation.name}' out of --inputs if it is not wanted")


def _sum(coefficients: Mapping[str, float], is_exact: bool) -> str:
    """Return a sum of columns as people write it, added terms before subtracted ones."""
    digits, text = 4 if is_exact else 2, ""
    for name, value in sorted(coefficients.items(), key=lambda pair: pair[1] < 0.0):
        size = f"{abs(value):.{digits}g}"
        term = name if size == "1" else f"{size}*{name}"
        sign = " - " if value < 0.0 else " + "
        text += f"{sign}{term}" if text else f"-{term}" if value < 0.0 else term
    return text
