"""The units of an equation: the units that its constants must have, and terms with impossible units. Pure.

The exponents of each base symbol obey linear equations: both sides of a sum have the same unit, arguments of functions
and exponents have no unit, and the whole has the unit of the left-hand side. The unknowns are the units of constants,
and of variables without a given unit. The linear equations are solved one by one (Gaussian elimination), for inner
nodes first. If an equation contradicts the earlier ones, its term is reported. So if two terms contradict each other,
the order decides which one is reported.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Final

from atoll_coordinator.units import NO_UNIT, Unit, expanded, parse_unit, product_of
from atoll_core.config import Angle
from atoll_core.errors import UsageError
from atoll_core.expression.operators import (
    ABS,
    ADD,
    ARITY,
    CONSTANT,
    DIVIDE,
    INVERSE,
    MULTIPLY,
    NEGATE,
    POW,
    SQRT,
    SQUARE,
    SUBTRACT,
    VARIABLE,
)
from atoll_core.expression.program import Program, constant_places, live_nodes
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.unit_coefficients import make_coefficients_explicit

Vector = dict[str, Fraction]
"""Exponents by base symbol, and coefficients of unknowns by their names, which begin with a blank."""

_DIGITS: Final = 3
_POWERS: Final = {
    NEGATE: Fraction(1),
    ABS: Fraction(1),
    INVERSE: Fraction(-1),
    SQUARE: Fraction(2),
    SQRT: Fraction(1, 2),
}


@dataclass(frozen=True)
class EquationUnits:
    """The results of the units of one equation.

    `constants` has the unit of each constant in node order, None if it is not determined. `implied` are units of
    unwritten factors 1 that are no pure numbers, each with the text of the part that it multiplies: such a term is only
    correct with this unit. `faults` are clauses about terms whose unit no factor can correct.
    """

    constants: tuple[Unit | None, ...]
    implied: tuple[tuple[str, Unit], ...] = ()
    faults: tuple[str, ...] = ()


def units_of(program: Program, names: Sequence[str], units: Mapping[str, Unit], left: Unit | None) -> EquationUnits:
    """Return the units of the constants of `program`, and the terms with impossible units.

    Args:
        program: the right-hand side.
        names: names of the variables.
        units: known units of variables, by name.
        left: unit of the left-hand side; None: not known.
    """
    explicit = make_coefficients_explicit(program)
    strict = _Inference(explicit.program, names, {name: expanded(unit) for name, unit in units.items()}, units)
    strict.close(None if left is None else expanded(left), left)
    shown = _Inference(explicit.program, names, {name: dict(unit.powers) for name, unit in units.items()}, units)
    shown.close(None if left is None else dict(left.powers), left)
    written: dict[int, Unit | None] = {}
    implied: list[tuple[str, Unit]] = []
    terms = iter(explicit.terms)
    for origin, unit in zip(explicit.origins, shown.constants(), strict=True):
        if origin is not None:
            written[origin] = unit
            continue
        term = to_infix(next(terms), names, digits=_DIGITS)
        if unit is not None and not unit.is_none:
            implied.append((term, unit))
    return EquationUnits(tuple(written[number] for number in sorted(written)), tuple(implied), tuple(strict.faults))


def units_of_columns(texts: Mapping[str, str], angles: Iterable[Angle]) -> dict[str, Unit]:
    """Return the units of columns. If the text in a header is not a unit, the unit is unknown.

    Angles are in radians and have no unit.
    """
    units = {}
    for column, text in texts.items():
        try:
            units[column] = parse_unit(text)
        except UsageError:
            continue
    return units | {angle.column: NO_UNIT for angle in angles if units}


def rate_unit(unit: Unit | None, time: Unit | None, order: int) -> Unit | None:
    """Return the unit of a derivative of this order; None if a unit is not known."""
    return None if unit is None or time is None else unit.times(time, -order)


def units_of_sides(
    sides: Mapping[str, Program], names: Sequence[str], units: Mapping[str, Unit], lefts: Mapping[str, Unit]
) -> tuple[dict[str, Unit], dict[str, tuple[str, ...]]]:
    """Return the units that follow from several equations together, and their terms with impossible units.

    Numbers in the equations may have any unit. A name has one unit in all equations.

    Args:
        sides: the right-hand sides, by equation.
        names: names of the variables of the programs.
        units: known units of variables, by name.
        lefts: known units of left-hand sides, by equation.

    Returns:
        The units of names whose unit was not known and follows; and by equation, clauses about impossible terms.
    """
    strict, shown = dict[str, Vector](), dict[str, Vector]()
    faults: dict[str, tuple[str, ...]] = {}
    base_units = {name: expanded(unit) for name, unit in units.items()}
    given_units = {name: dict(unit.powers) for name, unit in units.items()}
    for equation, program in sides.items():
        left = lefts.get(equation)
        checked = _Inference(program, names, base_units, units, _solved=strict, tag=equation)
        checked.close(None if left is None else expanded(left), left)
        written = _Inference(program, names, given_units, units, _solved=shown, tag=equation)
        written.close(None if left is None else dict(left.powers), left)
        strict, shown = checked._solved, written._solved
        if checked.faults:
            faults[equation] = tuple(checked.faults)
    solved = {name: shown.get(f" {name}") for name in names if name not in units}
    return {
        name: Unit.of(powers)
        for name, powers in solved.items()
        if powers is not None and not any(map(_is_unknown, powers))
    }, faults


@dataclass
class _Inference:
    """Units of all nodes, and the equations between them, solved for one unknown each (reduced echelon form).

    Constants of different programs have different tags.
    """

    program: Program
    names: Sequence[str]
    known: Mapping[str, Mapping[str, Fraction]]
    given: Mapping[str, Unit]
    faults: list[str] = field(default_factory=list)
    _solved: dict[str, Vector] = field(default_factory=dict)
    tag: str = ""
    _of_nodes: list[Vector] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._top_terms, self._top_sums = self._at_top(len(self.program) - 1)
        for index in range(len(self.program)):
            self._of_nodes.append(self._node(index))

    def close(self, left: Mapping[str, Fraction] | None, unit: Unit | None) -> None:
        """Require that each top-level term has the unit of the left-hand side or, if not known, of the first term."""
        first = self._top_terms[0]
        wanted = self._of_nodes[first] if left is None else dict(left)
        shown = self._unit(first) if unit is None else _unit_phrase(unit)
        for term in self._top_terms:
            if not self._equate(self._of_nodes[term], wanted):
                self._report_fault(f"the term {self._text(term)} has {self._unit(term)} instead of {shown}")

    def constants(self) -> tuple[Unit | None, ...]:
        """Return the unit of each constant, None if it is not determined."""
        units = []
        for place in constant_places(self.program):
            powers = self._reduced(self._of_nodes[place])
            units.append(None if any(_is_unknown(name) for name in powers) else Unit.of(powers))
        return tuple(units)

    def _at_top(self, index: int) -> tuple[list[int], list[int]]:
        """Return the terms of the sum at the top, and the nodes that add and subtract them."""
        code, left, right = self._parts(index)
        if code == NEGATE:
            return self._at_top(left)
        if code not in (ADD, SUBTRACT):
            return [index], []
        (terms, sums), (more_terms, more_sums) = self._at_top(left), self._at_top(right)
        return [*terms, *more_terms], [index, *sums, *more_sums]

    def _parts(self, index: int) -> tuple[int, int, int]:
        program = self.program
        return int(program.operators[index]), int(program.left[index]), int(program.right[index])

    def _node(self, index: int) -> Vector:
        code, left, right = self._parts(index)
        if code == VARIABLE:
            name = self.names[left]
            return dict(self.known[name]) if name in self.known else {f" {name}": Fraction(1)}
        if code == CONSTANT:
            return {f" constant {index} {self.tag}": Fraction(1)}
        first = self._of_nodes[left]
        second = self._of_nodes[right] if ARITY[code] == 2 else {}
        if code in (ADD, SUBTRACT):
            return self._sum(index, left, right)
        if code in (MULTIPLY, DIVIDE):
            return product_of(first, second, Fraction(1 if code == MULTIPLY else -1))
        if code in _POWERS:
            return product_of({}, first, _POWERS[code])
        if code == POW:
            return self._power(index, left, right)
        self._require_number(left, f"the argument {self._text(left)} of a function")
        return {}

    def _sum(self, index: int, left: int, right: int) -> Vector:
        if index not in self._top_sums and not self._equate(self._of_nodes[left], self._of_nodes[right]):
            texts = f"{self._text(left)} has {self._unit(left)} and {self._text(right)} {self._unit(right)}"
            self._report_fault(f"{texts}, but they are added")
        return dict(self._of_nodes[left])

    def _power(self, index: int, left: int, right: int) -> Vector:
        self._require_number(right, f"the exponent {self._text(right)}")
        if self.program.operators[right] == CONSTANT:
            exponent = Fraction(float(self.program.constants[right])).limit_denominator(1000)
            return product_of({}, self._of_nodes[left], exponent)
        self._require_number(left, f"{self._text(left)}, raised to a power that varies,")
        return {}

    def _require_number(self, index: int, what: str) -> None:
        if not self._equate(self._of_nodes[index], {}):
            self._report_fault(f"{what} has {self._unit(index)} instead of none")

    def _report_fault(self, clause: str) -> None:
        if clause not in self.faults:
            self.faults.append(clause)

    def _equate(self, one: Vector, other: Vector) -> bool:
        """Require that two units are equal; return False, and change nothing, if this contradicts known equations."""
        difference = self._reduced(product_of(one, other, Fraction(-1)))
        unknowns = [name for name in difference if _is_unknown(name)]
        if not unknowns:
            return not difference
        unknown = unknowns[0]
        factor = difference.pop(unknown)
        solution = {name: -power / factor for name, power in difference.items()}
        self._solved = {name: _substituted(vector, unknown, solution) for name, vector in self._solved.items()}
        self._solved[unknown] = solution
        return True

    def _reduced(self, vector: Vector) -> Vector:
        reduced = vector
        for name in [name for name in vector if name in self._solved]:
            reduced = _substituted(reduced, name, self._solved[name])
        return reduced

    def _unit(self, index: int) -> str:
        """Return words for the unit of a node, "another unit" if it is not known, in the symbols of the given units."""
        written = {name: dict(unit.powers) for name, unit in self.given.items()}
        inference = _Inference(_part(self.program, index), self.names, written, {})
        powers = inference._reduced(inference._of_nodes[-1])
        return "another unit" if any(map(_is_unknown, powers)) else _unit_phrase(Unit.of(powers))

    def _text(self, index: int) -> str:
        return to_infix(_part(self.program, index), self.names, digits=_DIGITS)


def _unit_phrase(unit: Unit) -> str:
    return f"the unit {unit}" if unit.powers else "no unit"


def _part(program: Program, index: int) -> Program:
    return Program.of(live_nodes(program.nodes(), index))


def _is_unknown(name: str) -> bool:
    return name.startswith(" ")


def _substituted(vector: Vector, name: str, solution: Vector) -> Vector:
    substituted = dict(vector)
    factor = substituted.pop(name, Fraction(0))
    return product_of(substituted, solution, factor) if factor else substituted
