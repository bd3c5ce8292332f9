"""Checks of the values of columns. Pure.

Single columns: fill values, clipping, few levels, held inputs, row counters. Columns that determine each other: equal
columns, multiples, totals, sums that stay constant. Such columns are found by least squares: each column is projected
on the columns before it (modified Gram-Schmidt, applied twice). An equation with such columns can be written in several
ways, so the user should know these columns.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import cache
from typing import Final

import numpy as np

from atoll_coordinator.data.columns.examined_columns import (
    ColumnFinding,
    ExaminedColumns,
    Parts,
    dot,
    listed,
    mean,
    quoted,
    roughness,
    upper_median,
    variance,
)
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

LIMITS = SETTINGS.columns
_FEW: Final = SETTINGS.common.few_values
_REPEATS: Final = 2
"""Fewest rows with a fill value, and fewest jumps of a held column: smaller numbers may be chance."""
_RUN: Final = 3
"""Fewest consecutive equal rows that count as clipped: two may be a rounded turning point."""
_STEEP_STEPS: Final = 10.0
"""Next to clipped rows a column moves by more than this number of rounding steps. A column without clipping moves less:
if a smooth turning point (a parabola) stays within one step for m rows, the column moves by at most 2.7 steps (m = 3)
in the next rows; at a flat turning point (fourth power) it moves by 7 steps."""
_MOST_CLIPPED: Final = 4
"""Most clipped values for each unclipped value: with more clipped values, too little of the column is known."""
_ROUNDING: Final = 1e-12
"""Guard: values that differ by less than this share of their size are one value."""

# -------------------------------------------------------------------------------------------------------- fill values


def check_fill_values(columns: ExaminedColumns) -> Iterator[ColumnFinding]:
    """Yield a finding for each value that seems to mean a missing measurement, such as -9999."""
    for name, value in fill_values(columns).items():
        values = columns.finite(name)
        others, count = values[values != value], int(np.count_nonzero(values == value))
        rows = "1 row holds" if count == 1 else f"{count} rows hold"
        yield ColumnFinding(
            f"{rows} {value:.15g} in '{name}', whose other values lie between {float(np.min(others)):.4g} and "
            f"{float(np.max(others)):.4g}",
            f"if it stands for a missing value, add --missing-value {value:.15g}",
        )


def fill_values(columns: ExaminedColumns) -> dict[str, float]:
    """Return the value that seems to mean a missing measurement, for each column with such a value."""
    found = {name: _fill_value(columns.finite(name)) for name in columns.values if name not in columns.angles}
    return {name: value for name, value in found.items() if value is not None}


def _fill_value(values: FloatArray) -> float | None:
    """Return the least or the largest value, if it is repeated and its distance from the other values exceeds their
    range.

    A moving quantity would have passed through values in between. There must be several other values, because a column
    of two or three values may be switched. Most rows must have the other values. A number of nines, such as -9999, need
    not be repeated.
    """
    unique, counts = np.unique(values, return_counts=True)
    if len(unique) <= _FEW:
        return None
    gaps = np.diff(unique)
    for end, gap, rest in ((0, gaps[0], unique[1:]), (-1, gaps[-1], unique[:-1])):
        others, size = float(rest[-1] - rest[0]), float(np.max(np.abs(rest)))
        value, count = float(unique[end]), int(counts[end])
        digits = f"{abs(value):.15g}".replace(".", "")
        is_nines = len(digits) > 1 and set(digits) == {"9"}
        enough = 1 if is_nines else _REPEATS
        if gap > others > _ROUNDING * size and enough <= count < len(values) // 2:
            return value
    return None


# ----------------------------------------------------------------------------------------------------------- clipping


def check_clipping(columns: ExaminedColumns) -> Iterator[ColumnFinding]:
    """Yield a finding for each clipped state: its sensor was at the end of its range for several rows."""
    if not columns.is_in_time or columns.config.data.stochastic:
        return
    for name in columns.roles.states:
        if name in columns.angles:
            continue
        clipped = _clipped(columns.values[name])
        rows = sum(int(np.count_nonzero(columns.whole[name] == value)) for value in clipped)
        if not clipped or len(columns.finite(name)) - rows < rows // _MOST_CLIPPED:
            continue
        bounds = " and ".join(f"{value:.6g}" for value in clipped)
        yield ColumnFinding(
            f"{rows} values of '{name}' are exactly {bounds}, like values of a sensor at the end of its range",
            "they are treated as missing values, since the true values may lie beyond the range",
            missing=tuple((name, value) for value in clipped),
        )


def _clipped(parts: Parts) -> list[float]:
    """Return the largest value, the least value, or both, if a fast moving state stops there abruptly.

    A state without clipping comes to rest gradually: near a rounded turning point it moves by a few rounding steps. A
    held state stays at other values as well.
    """
    values = np.concatenate(list(parts))
    unique = np.unique(values[np.isfinite(values)])
    if len(unique) <= _FEW:
        return []
    steep = _STEEP_STEPS * float(np.min(np.diff(unique)))
    abrupt = {float(unique[-1]): False, float(unique[0]): False}
    for part in parts:
        begins = np.flatnonzero(np.concatenate([[True], part[1:] != part[:-1]]))
        ends = np.append(begins[1:], len(part))
        is_long = ends - begins >= _RUN
        for first, last in zip(begins[is_long].tolist(), ends[is_long].tolist(), strict=True):
            value = float(part[first])
            if value not in abrupt:
                return []
            if first >= 2 and last <= len(part) - 2:
                steps = abs(float(part[first - 1] - part[first - 2])), abs(float(part[last + 1] - part[last]))
                abrupt[value] = abrupt[value] or all(step > steep for step in steps)
    return [value for value, is_abrupt in abrupt.items() if is_abrupt]


# ----------------------------------------------------------------------------------------------------------- counters


def check_counters(columns: ExaminedColumns) -> Iterator[ColumnFinding]:
    """Yield a finding for the states that count the rows.

    The equations of these states are not searched if another state remains.
    """
    states = columns.roles.states
    counters = tuple(
        name
        for name in states
        if columns.may_leave_out(name)
        and all((part == np.floor(part)).all() and (np.diff(part) == 1.0).all() for part in columns.values[name])
    )
    if counters and len(counters) < len(states):
        counts, them, are = ("counts", "it", "is") if len(counters) == 1 else ("count", "them", "are")
        yield ColumnFinding(
            f"{quoted(counters)} {counts} the rows and {are} no quantity of the system",
            f"no equation is searched for {them} (--states {listed(states)} keeps {them})",
            left_out=counters,
        )


# ------------------------------------------------------------------------------------------- few levels and held inputs


def check_held_inputs(columns: ExaminedColumns) -> Iterator[ColumnFinding]:
    """Yield a finding for inputs that seem to be held between rows; all other inputs are smooth curves between rows."""
    data = columns.config.data
    if not columns.is_in_time or data.stochastic:
        return
    held = [
        name
        for name in columns.roles.inputs
        if name not in (*data.hold, *columns.angles)
        and (is_held(columns.values[name]) or _is_white(columns.values[name]))
    ]
    if held:
        jump = "jumps, like an input that is" if len(held) == 1 else "jump, like inputs that are"
        yield ColumnFinding(
            f"{quoted(held)} {jump} constant from each row to the next",
            f"if so, add --hold {listed((*data.hold, *held))}, otherwise inputs are smooth curves between rows",
        )


def check_few_levels(columns: ExaminedColumns) -> Iterator[ColumnFinding]:
    """Yield a finding for each state with only a few values: it was rounded, or it is switched."""
    if not columns.is_in_time:
        return
    for name in columns.roles.states:
        values = columns.finite(name)
        as_input = f"add --inputs {listed((*columns.roles.inputs, name))}"
        if has_few_levels(columns.values[name]):
            levels = np.unique(values)
            error = float(np.min(np.diff(levels))) / math.sqrt(12.0)
            share = error / math.sqrt(variance(values))
            yield ColumnFinding(
                f"'{name}' takes {len(levels)} values only; if it was rounded to them, its errors are {error:.2g} at "
                f"least ({100.0 * share:.2g} % of its standard deviation)",
                f"record it in finer steps, or, if it is switched, {as_input}",
            )
        elif is_held(columns.values[name]):
            yield ColumnFinding(
                f"'{name}' keeps its value for several rows and then jumps, so it has no derivative",
                f"if it acts on the other states from outside, {as_input}",
            )


def has_few_levels(parts: Parts) -> bool:
    """Tell whether so many values are repeated that the column is rounded or switched.

    Suppose that a moving quantity was recorded in finer steps, at most half of the steps between the observed values.
    Then a further value equals one of the observed values with probability 1/2 at most, so many repetitions are
    improbable. A wave whose period is a whole number of rows also repeats its values, each once or twice in a period;
    such a wave does not count.
    """
    values = _finite(parts)
    levels = len(np.unique(values))
    by_chance = math.log2(1.0 / SETTINGS.common.improbable)
    if not 1 < levels < _FEW or len(values) - levels < by_chance:
        return False
    return levels == 2 or not repeats_in_step(parts)


def repeats_in_step(parts: Parts) -> bool:
    """Tell whether a column is a wave whose period is a whole number of rows, each value once or twice in a period."""
    levels = len(np.unique(_finite(parts)))
    return any(_has_period(parts, period) for period in range(levels, 2 * levels + 1))


def _has_period(parts: Parts, period: int) -> bool:
    repeated = 0
    for part in parts:
        later, earlier = part[period:], part[:-period]
        both = np.isfinite(later) & np.isfinite(earlier)
        if not np.array_equal(later[both], earlier[both]):
            return False
        repeated += int(np.count_nonzero(both))
    return repeated >= period


def _finite(parts: Parts) -> FloatArray:
    values: FloatArray = np.concatenate(list(parts))
    return values[np.isfinite(values)]


def is_held(parts: Parts) -> bool:
    """Tell whether a column is constant from most rows to the next, and then jumps.

    A column with only a few values always counts as held.

    A rounded quantity that moves smoothly does not count as held: it changes to adjacent values, while a held column
    makes larger jumps.
    """
    if has_few_levels(parts):
        return True
    steps = np.abs(np.concatenate([np.diff(part) for part in parts]))
    steps, levels = steps[np.isfinite(steps)], np.unique(_finite(parts))
    jumps = steps[steps > 0.0]
    if len(jumps) < _REPEATS or 2 * len(jumps) > len(steps):
        return False
    typical, least = upper_median(jumps), 1.5 * upper_median(np.diff(levels))
    return typical > SETTINGS.inference.part * float(levels[-1] - levels[0]) and typical > least


def _is_white(parts: Parts) -> bool:
    """Tell whether a column looks like white noise: neighbouring rows do not predict a row.

    The rows of a wave are predictable even with few rows in a period: their correlation with the sum of both neighbours
    is 1 or -1.
    """
    rows = np.concatenate([part[1:-1] for part in parts if len(part) > 2] or [np.zeros(0)])
    around = np.concatenate([part[2:] + part[:-2] for part in parts if len(part) > 2] or [np.zeros(0)])
    is_known = np.isfinite(rows) & np.isfinite(around)
    rows, around = rows[is_known], around[is_known]
    if len(rows) < LIMITS.least_rows:
        return False
    product = variance(rows) * variance(around)
    covariance = dot(rows - mean(rows), around - mean(around)) / len(rows)
    return product > 0.0 and covariance * covariance < SETTINGS.common.significant**2 * product / len(rows)


# ------------------------------------------------------------------------------------ columns that determine each other


_MOST_COLUMNS: Final = 100
"""Most columns that are compared by least squares: the time grows with the square of their number."""
_ROWS_PER_COLUMN: Final = 10
"""Fewest rows for each column of a relation up to noise: with fewer, patterns in residuals cannot be detected."""
Values = Mapping[str, FloatArray]


@dataclass(frozen=True)
class Relation:
    """``name = constant + sum of coefficient * column``, exact up to rounding, or valid up to noise.

    `residual` is the standard deviation of the residuals, divided by the standard deviation of the column `name`.
    """

    name: str
    coefficients: Mapping[str, float]
    constant: float
    is_exact: bool
    residual: float

    def solved_for(self, name: str) -> "Relation":
        """Return the relation solved for another of its columns."""
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


def check_relations(columns: ExaminedColumns) -> Iterator[ColumnFinding]:
    """Yield a finding for each column that other columns determine.

    If a state is a multiple or a sum of other columns up to rounding, the equation of this state is not searched: no
    information is lost. If the relation has a constant (a sum that stays 1, degrees Celsius and kelvin), each column
    keeps its equation.
    """
    left_out: list[str] = []
    states = columns.roles.states
    for relation in linear_relations(columns):
        total = relation
        if not any(name in left_out for name in relation.columns):  # the column that is the sum of the other columns
            forms = [relation.solved_for(name) for name in reversed(relation.columns)]
            sums = (form for form in forms if all(value > 0.0 for value in form.coefficients.values()))
            total = next(sums, relation)
        is_redundant = relation.is_exact and total.constant == 0.0
        if is_redundant and columns.may_leave_out(total.name) and len(states) - len(left_out) > 1:
            left_out.append(total.name)
            yield ColumnFinding(
                f"'{total.name}' is {_sum(total.coefficients, total.is_exact)} in every row, so that it only adds "
                "other ways to write each equation",
                f"no equation is searched for it (--states {listed(states)} keeps it)",
                left_out=(total.name,),
            )
        else:
            yield _remark(relation if total.constant else total, states, left_out)


def linear_relations(columns: ExaminedColumns) -> list[Relation]:
    """Return the relation of each column that is determined by the columns before it."""
    roles = columns.roles
    names = [name for name in roles.variables if name in columns.values and name != roles.target]
    if len(names) > _MOST_COLUMNS or (columns.roles.order == 2 and len(names) < 2):
        return []
    rows = np.flatnonzero(np.logical_and.reduce([np.isfinite(columns.whole[name]) for name in names] or [np.zeros(0)]))
    some = rows[:: -(-len(rows) // SETTINGS.rows.in_sums) or 1]
    sampled = {name: columns.whole[name][some] for name in names}
    whole = {name: columns.whole[name][rows] for name in names}
    basis = _Basis(sampled, whole)
    relations: list[Relation] = []
    for name in names:
        spread = variance(sampled[name])
        if len(rows) <= len(basis.names) + SETTINGS.common.few_values or not spread > 0.0:
            continue
        found = basis.relation(name, math.sqrt(spread))
        if found is None:
            basis.add(name)
        else:
            relations.append(found)
    return relations


class _Basis:
    """Orthonormal columns, and their coefficients in terms of the table's columns, all with means subtracted.

    `sampled` are the values of some rows. `whole` are the values of all rows, in which an exact relation must hold.
    """

    def __init__(self, sampled: Values, whole: Values) -> None:
        self.names: list[str] = []
        self._sampled, self._whole = sampled, whole
        self._step_of = cache(lambda name: _step(sampled[name]))
        self._units: list[FloatArray] = []
        self._coefficients: list[list[float]] = []

    def add(self, name: str) -> None:
        shares, rest = self._projected(self._sampled[name])
        size = math.sqrt(dot(rest, rest))
        own = [-value for value in self._combined(shares)]
        self.names.append(name)
        self._units.append(rest / size)
        self._coefficients = [[*row, 0.0] for row in self._coefficients] + [[entry / size for entry in (*own, 1.0)]]

    def _projected(self, values: FloatArray) -> tuple[list[float], FloatArray]:
        """Return the coefficients of the orthonormal columns in the values, and the residuals."""
        shares, rest = [0.0] * len(self._units), values - mean(values)
        for _ in range(2):  # the second time removes the rounding errors of the first time
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

    def relation(self, name: str, deviation: float) -> Relation | None:
        """Return how a column with this standard deviation depends on the columns of the basis; None: it does not
        depend on them."""
        shares, rest = self._projected(self._sampled[name])
        if not self.names or math.sqrt(variance(rest)) / deviation > LIMITS.alike:
            return None
        coefficients = dict(zip(self.names, self._combined(shares), strict=True))
        exact = _exact(name, coefficients, self._sampled, self._whole, deviation, self._step_of)
        return exact or _noisy(name, coefficients, self._sampled, deviation, rest)


def _exact(
    name: str, coefficients: Mapping[str, float], sampled: Values, whole: Values, deviation: float,
    step_of: Callable[[str], float],
) -> Relation | None:  # fmt: skip
    """Return the relation if it holds in every row up to rounding errors of arithmetic or of the written digits.

    `step_of` returns the rounding step of a column, see `_step`.
    """
    least = SETTINGS.common.negligible * deviation
    for terms in (_without_small(coefficients, sampled, least) or coefficients, coefficients):
        steps = [abs(factor) * step_of(other) for other, factor in terms.items()]
        written = 2.0 * (step_of(name) + sum(steps))
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
    # a few extreme rows, as at the beginning of a motion, dominate a mean square, but not a median
    above = rest > upper_median(rest)
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
    """Return the rounding step with which the largest values of a column were written."""
    some = values[:: max(1, len(values) // SETTINGS.rows.compared)]
    largest = float(np.max(np.abs(values)))
    numbers = [Decimal(repr(value)).normalize() for value in some.tolist() if value != 0.0]
    digits = max((len(number.as_tuple().digits) for number in numbers), default=1)
    place = min((int(number.as_tuple().exponent) for number in numbers), default=0)
    by_digits = 10.0 ** (Decimal(repr(largest)).adjusted() + 1 - digits) if largest else 0.0
    if 0.0 < largest < float(np.finfo(np.float32).max) and (values.astype(np.float32) == values).all():
        by_digits = max(by_digits, float(np.spacing(np.float32(largest))))
    return max(min(10.0**place, largest), by_digits, 4.0 * float(np.spacing(largest)))


def _remark(relation: Relation, states: Sequence[str], left_out: Sequence[str]) -> ColumnFinding:
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
        return ColumnFinding(found, f"to do without '{relation.name}', add --states {listed(others)}")
    return ColumnFinding(found, f"leave '{relation.name}' out of --inputs if it is not wanted")


def _sum(coefficients: Mapping[str, float], is_exact: bool) -> str:
    """Return the text of a sum of columns, with added terms before subtracted terms."""
    digits, text = 4 if is_exact else 2, ""
    for name, value in sorted(coefficients.items(), key=lambda pair: pair[1] < 0.0):
        size = f"{abs(value):.{digits}g}"
        term = name if size == "1" else f"{size}*{name}"
        sign = " - " if value < 0.0 else " + "
        text += f"{sign}{term}" if text else f"-{term}" if value < 0.0 else term
    return text
