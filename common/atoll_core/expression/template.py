"""Templates: right-hand sides of which a part is given, with named parameters and unknown parts. Pure.

A template has, for some of the equations, a side that the user wrote, for example ``-g/l*sin(theta) - c*v + ?``. The
names that are no variables are *parameters*: numbers that are fitted. Numbers in the text are not fitted. ``?`` is an
*unknown*: an expression that is searched. ``?(v, u)`` names the variables that it may depend on, and ``?1`` may occur
in several sides; it is the same expression in all of them.

How it works. A side is a program over variables, then parameters, then unknowns, which are all variables of this
program. `EquationTemplate.compose` replaces each parameter by a constant and each unknown by its program, and tells
where the constants are then. Each unknown belongs to one equation, its home: the first equation that contains it. So
systems are still compared with one searched program for each equation; only the program of an equation with a template
is the unknown part, and not the whole side. A side without an unknown of its own has nothing to search.

Letters: V variables, P parameters, U unknowns, D equations.
"""

import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from atoll_core.expression import operators as op
from atoll_core.expression.operators import ARITY, CONSTANT, FUNCTIONS, VARIABLE
from atoll_core.expression.program import (
    MAX_NODES,
    Expression,
    Program,
    ProgramBuilder,
    constant_places,
    dependent_nodes,
    variables_of,
)
from atoll_core.expression.text.parsing import from_infix, names_in
from atoll_core.expression.unit_coefficients import ExplicitCoefficients
from atoll_core.quoting import did_you_mean

_UNKNOWN: Final = re.compile(r"\?(?P<number>\d*)(?P<arguments>\s*\([^()?]*\))?")
_LETTER: Final = "ʔ"
"""The letter that stands for the question mark of an unknown while a side is parsed. It is as long, so that positions
in error messages stay right."""
_RESERVED: Final = frozenset({*FUNCTIONS.values(), "Abs", "tan", "cot", "pi"})


@dataclass(frozen=True)
class TemplateParameter:
    """A named number of a template, with bounds; `start` is the value from which fits start, None: not given."""

    name: str
    lower: float = -math.inf
    upper: float = math.inf
    start: float | None = None

    @property
    def first_value(self) -> float:
        """The value with which fits start: `start`, or the middle of the bounds; of positive bounds the geometric
        mean. It is 1 or the bound nearest to 1 if a bound is missing."""
        if self.start is not None:
            return self.start
        if math.isinf(self.lower) or math.isinf(self.upper):
            return min(max(1.0, self.lower), self.upper)
        if self.lower > 0.0:
            return math.sqrt(self.lower) * math.sqrt(self.upper)
        return 0.5 * (self.lower + self.upper)


@dataclass(frozen=True)
class Unknown:
    """An unknown part: its `label`, such as ``?`` or ``?1``; its `home`, the equation under whose name it is searched;
    the equations in which it occurs; and the variables that it may depend on (None: all)."""

    label: str
    home: str
    equations: tuple[str, ...]
    variables: tuple[str, ...] | None = None


ZERO: Final = Program.of([(CONSTANT, 0, 0, 0.0)])
"""The program that stands for an unknown part that is not known yet."""
Place = tuple[int, int]
"""A constant: (equation, node in this equation)."""


@dataclass(frozen=True)
class ConstantSource:
    """The origin of a constant of a side: a parameter by its index, or constant `number` of the program that was
    searched for the equation `home`. A number of the user's text has neither."""

    parameter: int | None = None
    home: int | None = None
    number: int = 0


@dataclass(frozen=True, eq=False)
class Composition:
    """The equations of a system with a template, composed of the searched programs and the parameters.

    Attributes:
        programs: the right-hand sides (D).
        fixed: for each equation the nodes of numbers that are not fitted.
        slots: the searched program of each equation (D). Where nothing is searched, it is the right-hand side itself.
        places: for each slot, the places of each of its constants, by node.
        parameters: the places of each parameter (P).
        given: the equations, by index, under whose name nothing is searched.
    """

    programs: tuple[Program, ...]
    fixed: tuple[frozenset[int], ...]
    slots: tuple[Program, ...]
    places: tuple[Mapping[int, tuple[Place, ...]], ...]
    parameters: tuple[tuple[Place, ...], ...]
    given: frozenset[int]

    def sources(self, index: int) -> list[ConstantSource]:
        """Return the origin of each constant of a side, in node order."""
        known = {place: ConstantSource(parameter) for parameter, own in enumerate(self.parameters) for place in own}
        for home in {*range(len(self.slots))} - self.given:
            for number, node in enumerate(constant_places(self.slots[home])):
                known |= dict.fromkeys(self.places[home].get(node, ()), ConstantSource(None, home, number))
        return [known.get((index, node), ConstantSource()) for node in constant_places(self.programs[index])]


def written_sources(
    sources: Sequence[ConstantSource], explicit: Sequence[ExplicitCoefficients]
) -> Iterator[tuple[int, ConstantSource | None]]:
    """Yield the index of each fitted constant of a side, and its origin in the side as it is written.

    Args:
        sources: the origins of all constants of the side, which was composed of the `explicit` programs.
        explicit: the searched programs with written factors of one. Such a factor has the origin None.
    """
    for index, source in enumerate(sources):
        if source.home is not None:
            number = explicit[source.home].origins[source.number]
            yield index, None if number is None else replace(source, number=number)
        elif source.parameter is not None:
            yield index, source


@dataclass(frozen=True, eq=False)
class EquationTemplate:
    """Sides of equations with parameters and unknowns, see the module.

    Without sides, whole right-hand sides are searched.

    Attributes:
        names: the variables (V) of the programs.
        parameters: the parameters (P), in the order of their first occurrence.
        unknowns: the unknowns (U).
        sides: by equation, programs over variables, then parameters, then unknowns.
        texts: the sides as the user wrote them, by equation.
        observed: the columns, among the keys of `sides`, whose sides are measured values and no derivatives.
        equations: names of the equations (D) of the system that is composed, see `for_equations`.
    """

    names: tuple[str, ...] = ()
    parameters: tuple[TemplateParameter, ...] = ()
    unknowns: tuple[Unknown, ...] = ()
    sides: Mapping[str, Program] = field(default_factory=dict)
    texts: Mapping[str, str] = field(default_factory=dict)
    observed: tuple[str, ...] = ()
    equations: tuple[str, ...] = ()

    @property
    def starts(self) -> FloatArray:
        """The values (P,) of the parameters with which fits start."""
        return np.array([parameter.first_value for parameter in self.parameters])

    def unknown_of(self, equation: str) -> Unknown | None:
        """Return the unknown that is searched under the name of this equation; None if there is none."""
        return next((unknown for unknown in self.unknowns if unknown.home == equation), None)

    def is_given(self, equation: str) -> bool:
        """Tell whether nothing is searched under the name of this equation, since its side has no unknown of its
        own."""
        return equation in self.sides and self.unknown_of(equation) is None

    def parameters_in(self, equation: str) -> list[int]:
        """Return the indices of the parameters in the side of this equation."""
        side = self.sides.get(equation)
        used = set() if side is None else variables_of(side)
        return [place for place, _ in enumerate(self.parameters) if len(self.names) + place in used]

    def for_equations(self, equations: Sequence[str]) -> "EquationTemplate":
        """Return the template of the system of these equations.

        The parameters stay the same, so that their values keep their order.
        """
        sides = {name: side for name, side in self.sides.items() if name in equations}
        return replace(self, sides=sides, equations=tuple(equations))

    def unknowns_in(self, equation: str) -> list[int]:
        """Return the indices of the unknowns in the side of this equation."""
        first, side = len(self.names) + len(self.parameters), self.sides.get(equation)
        return sorted(index - first for index in variables_of(side) if index >= first) if side is not None else []

    def parts_of(self, equation: str, slots: Sequence[Program]) -> dict[str, Program]:
        """Return the unknown parts in the side of this equation by label; `slots` are as in `compose`."""
        unknowns = [self.unknowns[place] for place in self.unknowns_in(equation)]
        return {one.label: slots[self.equations.index(one.home)] for one in unknowns}

    def solved_for(self, equation: str, unknown: int) -> Program | None:
        """Return the value of an unknown as a program, from the value of the left-hand side of this equation.

        The program is over variables, parameters and unknowns as a side is; in the place of the unknown itself it has
        the left-hand side. None if the side cannot be solved, since the unknown occurs twice, or inside a function that
        has the same value for several arguments.
        """
        return _solve(self.sides[equation], len(self.names) + len(self.parameters) + unknown)

    def parameter_names(self, sources: Sequence[ConstantSource]) -> tuple[str | None, ...]:
        """Return the name of each constant that is a parameter; None for other constants."""
        return tuple(None if one.parameter is None else self.parameters[one.parameter].name for one in sources)

    def given_program(self, equation: str, values: FloatArray) -> Program:
        """Return the side of this equation with these values (P,) of the parameters; its unknown parts are 0."""
        return replace(self, equations=(equation,)).compose([], values).programs[0]

    def compose(self, slots: Sequence[Program], values: FloatArray) -> Composition:
        """Return the right-hand sides of the equations (D).

        Args:
            slots: for each equation, the program of its unknown or, without a side, of the whole right-hand side.
                Programs of sides without an unknown of their own are ignored. Missing programs at the end are 0, and
                so are unknowns at home in other equations.
            values: values (P,) of the parameters.
        """
        equations = self.equations
        slots = [*slots, *[ZERO] * (len(equations) - len(slots))]
        by_equation = {unknown.home: ZERO for unknown in self.unknowns} | dict(zip(equations, slots, strict=True))
        places: list[dict[int, tuple[Place, ...]]] = [{} for _ in equations]
        parameters: list[tuple[Place, ...]] = [() for _ in self.parameters]
        programs, fixed, held = list[Program](), list[frozenset[int]](), list[Program]()
        for index, (name, slot) in enumerate(zip(equations, slots, strict=True)):
            side = self.sides.get(name)
            if side is None:
                programs.append(slot)
                fixed.append(frozenset())
                held.append(slot)
                places[index] = {node: ((index, node),) for node in constant_places(slot)}
                continue
            draft = _SideDraft(self, by_equation, values)
            program = draft.compose(side)
            programs.append(program)
            fixed.append(frozenset(draft.literals))
            held.append(program if self.is_given(name) else slot)
            for parameter, node in draft.parameters.items():
                parameters[parameter] += ((index, node),)
                if self.is_given(name):
                    places[index][node] = ((index, node),)
            for home, nodes in draft.constants.items():
                own = places[equations.index(home)] if home in equations else {}
                for node, place in nodes.items():
                    own[node] = (*own.get(node, ()), (index, place))
        given = frozenset(index for index, name in enumerate(equations) if self.is_given(name))
        return Composition(tuple(programs), tuple(fixed), tuple(held), tuple(places), tuple(parameters), given)


def _solve(side: Program, variable: int) -> Program | None:
    """Return the inverse of `side` as a function of this variable, which occurs once; None if there is none.

    The operators on the way from the output to the variable are undone one after another.
    """
    nodes = side.nodes()
    leaves = [place for place, node in enumerate(nodes) if node[:2] == (VARIABLE, variable)]
    depends = dependent_nodes(nodes, leaves)
    builder = ProgramBuilder()
    places = builder.copy(nodes)
    value, place = builder.add(VARIABLE, variable), len(nodes) - 1
    while nodes[place][:2] != (VARIABLE, variable):
        code, left, right, _ = nodes[place]
        is_left = depends[left]
        if ARITY[code] == 2 and is_left and depends[right]:
            return None
        if ARITY[code] == 1:
            undone = _UNDONE.get(code)
        else:
            undone = _UNDONE_LEFT.get(code) if is_left else _UNDONE_RIGHT.get(code)
        if undone is None:
            return None
        other = 0 if ARITY[code] == 1 else places[right if is_left else left]
        value = builder.build(undone(value, other))
        place = left if ARITY[code] == 1 or is_left else right
    return builder.program(value)


_Undo = Callable[[int, int], Expression]
"""Returns the argument of an operator, from the operator's value and its other argument."""
_UNDONE: Final[Mapping[int, _Undo]] = {
    op.NEGATE: lambda value, _: (op.NEGATE, value),
    op.INVERSE: lambda value, _: (op.INVERSE, value),
    op.EXP: lambda value, _: (op.LOG, value),
    op.LOG: lambda value, _: (op.EXP, value),
    op.SQRT: lambda value, _: (op.SQUARE, value),
    op.TANH: lambda value, _: (
        op.MULTIPLY, 0.5, (op.LOG, (op.DIVIDE, (op.ADD, 1.0, value), (op.SUBTRACT, 1.0, value))),
    ),
}  # fmt: skip
_UNDONE_LEFT: Final[Mapping[int, _Undo]] = {
    op.ADD: lambda value, other: (op.SUBTRACT, value, other),
    op.SUBTRACT: lambda value, other: (op.ADD, value, other),
    op.MULTIPLY: lambda value, other: (op.DIVIDE, value, other),
    op.DIVIDE: lambda value, other: (op.MULTIPLY, value, other),
    op.POW: lambda value, other: (op.POW, value, (op.INVERSE, other)),
}
_UNDONE_RIGHT: Final[Mapping[int, _Undo]] = {
    op.ADD: lambda value, other: (op.SUBTRACT, value, other),
    op.SUBTRACT: lambda value, other: (op.SUBTRACT, other, value),
    op.MULTIPLY: lambda value, other: (op.DIVIDE, value, other),
    op.DIVIDE: lambda value, other: (op.DIVIDE, other, value),
    op.POW: lambda value, other: (op.DIVIDE, (op.LOG, value), (op.LOG, other)),
}


class _SideDraft:
    """One side while it is composed: where its literals, parameters and constants of unknowns are."""

    def __init__(self, template: EquationTemplate, slots: Mapping[str, Program], values: FloatArray) -> None:
        self._template, self._slots, self._values = template, slots, values
        self._builder = ProgramBuilder()
        self.literals: set[int] = set()
        self.parameters: dict[int, int] = {}
        self.constants: dict[str, dict[int, int]] = {}

    def compose(self, side: Program) -> Program:
        new: list[int] = []
        for code, left, right, value in side.nodes():
            if code == CONSTANT:
                new.append(self._builder.append(CONSTANT, value=value))
                self.literals.add(new[-1])
            elif code == VARIABLE:
                new.append(self._leaf(left))
            else:
                new += self._builder.copy([(code, left, right, value)], new)[len(new) :]
        if new[-1] != len(self._builder.nodes) - 1:  # the output is a node that was there before
            self._builder.append(*self._builder.nodes[new[-1]])
        return Program.of(self._builder.nodes)

    def _leaf(self, index: int) -> int:
        """Return the node for a variable, parameter or unknown of a side."""
        variables, parameters = len(self._template.names), len(self._template.parameters)
        if index < variables:
            return self._builder.add(VARIABLE, index)
        if index < variables + parameters:
            place = index - variables
            self.parameters[place] = self._builder.append(CONSTANT, value=float(self._values[place]))
            return self.parameters[place]
        home = self._template.unknowns[index - variables - parameters].home
        slot = self._slots[home]
        nodes = self._builder.copy(slot.nodes(), merges_constants=False)
        self.constants[home] = {node: nodes[node] for node in constant_places(slot)}
        return nodes[-1]


# ------------------------------------------------------------------------------------------------------------- reading


def read_template(
    sides: Mapping[str, str], parameters: Mapping[str, TemplateParameter], names: Sequence[str],
    observed: Collection[str] = (),
) -> EquationTemplate:  # fmt: skip
    """Return the template of these sides.

    Args:
        sides: the sides as text, by equation.
        parameters: parameters with bounds or start values, by name. Other names that occur in the sides are parameters
            without bounds.
        names: the symbols of the variables.
        observed: the keys of `sides` that are measured columns, and not equations. Their sides have no unknowns.

    Raises:
        UsageError: a side cannot be read, a parameter is not used or has the name of a variable, an unknown occurs
            twice in a side, a side has several unknowns of its own, or an unknown has the same number but other
            variables. The message is a sentence for the user.
    """
    found: dict[str, TemplateParameter] = {}
    labels: dict[str, _Occurrences] = {}
    for equation, text in sides.items():
        what = option_for(equation, observed)
        if equation in observed and "?" in text:
            raise UsageError(f"{what} has an unknown part, which is possible in equations only; write a parameter")
        for name in names_in(_without_unknowns(text, what)):
            if name not in names and name not in _RESERVED:
                _check_parameter_name(name, names, parameters, what)
                found.setdefault(name, parameters.get(name, TemplateParameter(name)))
        for match in _UNKNOWN.finditer(text):
            label = f"?{match['number']}" if match["number"] else f"? of {equation}"
            occurrences = labels.setdefault(label, _Occurrences())
            occurrences.add(equation, _arguments(match, names, what), f"--equation: {label}")
    _check_used(parameters, found, names)
    unknowns = _place_unknowns(labels)
    letters = [_LETTER + unknown.label[1:].split(" ")[0] for unknown in unknowns]
    programs = {}
    for equation, text in sides.items():
        own = [  # an unknown without a number is only known in its own side
            letter if letter != _LETTER or unknown.home == equation else f"{_LETTER}{_LETTER}{place}"
            for place, (letter, unknown) in enumerate(zip(letters, unknowns, strict=True))
        ]
        try:
            programs[equation] = from_infix(_with_letters(text), [*names, *found, *own])
        except UsageError as error:
            sentence = re.sub(f", {_LETTER}{_LETTER}\\d+", "", str(error)).replace(_LETTER, "?")
            raise UsageError(f"{option_for(equation, observed)}: {sentence}") from error
        parts, most = len(programs[equation]), MAX_NODES // 2
        if parts > most:
            raise UsageError(f"{option_for(equation, observed)} has {parts} parts; at most {most} are possible")
    return EquationTemplate(tuple(names), tuple(found.values()), unknowns, programs, dict(sides), tuple(observed))


def option_for(equation: str, observed: Collection[str]) -> str:
    """Return the option that gives a side, with the name of its equation or `observed` column, for messages."""
    return f"{'--observe' if equation in observed else '--equation'} for '{equation}'"


def _check_used(parameters: Collection[str], found: Collection[str], names: Sequence[str]) -> None:
    """Refuse a parameter that occurs in no side."""
    unused = next((name for name in parameters if name not in found), None)
    if unused is None:
        return
    if unused in names:
        raise UsageError(f"--parameter {unused} has the name of a column; choose another name")
    known = ", ".join(found) or "none"
    raise UsageError(
        f"--parameter {unused} occurs in no --equation and no --observe; the parameters there are: {known}"
        f"{did_you_mean(unused, list(found))}"
    )


@dataclass
class _Occurrences:
    """The sides in which an unknown occurs, in order, and the variables that it may depend on."""

    equations: list[str] = field(default_factory=list)
    variables: tuple[str, ...] | None = None

    def add(self, equation: str, variables: tuple[str, ...] | None, what: str) -> None:
        if self.variables is not None and variables is not None and set(self.variables) != set(variables):
            first, second = ", ".join(self.variables), ", ".join(variables)
            raise UsageError(f"{what} depends on {first} in one place and on {second} in another; name the same ones")
        self.variables = variables if self.variables is None else self.variables
        if equation not in self.equations:
            self.equations.append(equation)


def _place_unknowns(labels: Mapping[str, _Occurrences]) -> tuple[Unknown, ...]:
    """Return the unknowns; each has an equation as its home that is no other's home.

    Unknowns that occur in few equations choose first, so that a home is found wherever there is one (greedy matching
    with exchanges along augmenting paths).
    """
    homes: dict[str, str] = {}

    def settle(label: str, tried: set[str]) -> bool:
        for equation in labels[label].equations:
            if equation in tried:
                continue
            tried.add(equation)
            owner = next((other for other, home in homes.items() if home == equation), None)
            if owner is None or settle(owner, tried):
                homes[label] = equation
                return True
        return False

    for label, occurrences in labels.items():
        if not settle(label, set()):
            where = ", ".join(occurrences.equations)
            raise UsageError(
                f"--equation: there are more unknown parts than equations that could determine them ({label} in {where}"
                "); write one ? for each equation"
            )
    return tuple(
        Unknown(label.split(" ")[0], homes[label], tuple(one.equations), one.variables) for label, one in labels.items()
    )


def _without_unknowns(text: str, what: str) -> str:
    if _LETTER in text:
        raise UsageError(f"{what} has the letter {_LETTER}; write ? for an unknown part")
    return _UNKNOWN.sub(lambda match: " " * len(match[0]), text)


def _with_letters(text: str) -> str:
    """Return a side in which letters replace question marks, and blanks the arguments of unknowns."""
    return _UNKNOWN.sub(lambda match: f"{_LETTER}{match['number']}".ljust(len(match[0])), text)


def _arguments(match: re.Match[str], names: Sequence[str], what: str) -> tuple[str, ...] | None:
    if match["arguments"] is None:
        return None
    texts = tuple(text.strip() for text in match["arguments"].strip()[1:-1].split(",") if text.strip())
    wrong = next((text for text in texts if text not in names), None)
    if wrong is not None:
        known = ", ".join(names)
        raise UsageError(f"{what}: the unknown may depend on {known}, not on {wrong}{did_you_mean(wrong, names)}")
    if not texts:
        raise UsageError(f"{what}: {match[0]} names no variable; name at least one, or write ? alone")
    return texts


def _check_parameter_name(
    name: str, names: Sequence[str], parameters: Mapping[str, TemplateParameter], what: str
) -> None:
    """Refuse a name that is not declared and looks like a misspelt variable."""
    similar = did_you_mean(name, names)
    if name not in parameters and similar:
        raise UsageError(
            f"{what}: {name} is no column{similar}; if it is a parameter to be fitted, add --parameter {name}"
        )
