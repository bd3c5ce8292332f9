"""Right-hand sides that the user gave with parameters and unknown parts: where their constants come from.

A result has each side as one program, the text of the user, and the programs of its unknown parts. This module puts
the parts into the template again, and so finds for each constant of a side whether it is a number of the text, a
parameter, or a constant of an unknown part. Letters: D equations, P parameters.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np

from atoll_coordinator.result.equations import Constant, Equation, GroupEquation, Observation, UnknownPart
from atoll_coordinator.result.result import Result
from atoll_core.data.dataset import FloatArray, IntArray
from atoll_core.errors import UsageError
from atoll_core.expression.operators import VARIABLE
from atoll_core.expression.program import Program, constant_places, structure, with_constants
from atoll_core.expression.template import (
    ZERO,
    Composition,
    EquationTemplate,
    Place,
    TemplateParameter,
    read_template,
    written_sources,
)
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from atoll_core.expression.unit_coefficients import ExplicitCoefficients, as_written, make_coefficients_explicit


def program_of(equation: Equation | GroupEquation | Observation, names: Sequence[str]) -> Program:
    """Return the program of a right-hand side over variables `names`: from the result, or else parsed from the text."""
    if equation.program:
        return Program.from_bytes(bytes.fromhex(equation.program), len(names))
    return from_infix(equation.expression or "", names)


@dataclass(frozen=True, eq=False)
class GivenSides:
    """The equations (D) of a result of which some sides were given, and the measured columns (M) computed from states.

    `slots` (D) are the searched programs: unknown parts, and whole sides of equations without a template. `values` (P,)
    are the values of the parameters. The observed columns follow the equations in `template.equations`.
    """

    template: EquationTemplate
    slots: tuple[Program, ...]
    values: FloatArray

    @classmethod
    def of(cls, result: Result) -> Self:
        """Return the equations of a result; the template has no sides if none was given.

        Raises UsageError if the sides do not fit their parts.
        """
        given = {equation.variable: equation.given for equation in result.equations if equation.given is not None}
        columns, names = {one.column: one.given for one in result.observations}, result.names
        texts = {name: side.text for name, side in (given | columns).items()}
        template = read_template(texts, _parameters(result), names, tuple(columns))
        equations = tuple(equation.variable for equation in result.equations)
        template = replace(template, equations=(*equations, *columns))
        slots = [ZERO if equation.expression is None else program_of(equation, names) for equation in result.equations]
        programs = [*slots, *(program_of(one, names) for one in result.observations)]
        for unknown in template.unknowns:
            parts = [part for part in given[unknown.home].unknowns if part.label == unknown.label]
            slots[equations.index(unknown.home)] = _part_program(parts[0], names) if parts else ZERO
        empty = cls(template, tuple(slots), np.zeros(len(template.parameters)))
        if [*map(structure, empty.composition.programs)] != [*map(structure, programs)]:
            raise UsageError("given equations of the result do not fit their unknown parts; was the result changed?")
        return empty.with_values_of(programs)

    @cached_property
    def composition(self) -> Composition:
        """The equations, composed of the slots and the parameters."""
        return self.template.compose(self.slots, self.values)

    @property
    def equations(self) -> tuple[str, ...]:
        """The names of the equations (D)."""
        return self.template.equations[: len(self.slots)]

    @property
    def programs(self) -> tuple[Program, ...]:
        """The right-hand sides (D)."""
        return self.composition.programs[: len(self.slots)]

    @property
    def observations(self) -> dict[str, Program]:
        """The measured columns that are computed from states, by name."""
        count = len(self.slots)
        return dict(zip(self.template.equations[count:], self.composition.programs[count:], strict=True))

    def is_given(self, index: int) -> bool:
        """Tell whether the side of this equation was given."""
        return self.template.equations[index] in self.template.sides

    def with_values_of(self, programs: Sequence[Program]) -> Self:
        """Return the same sides with the constants of `programs` (D or D + M), which have the structure of the sides.

        Without the programs of observed columns, parameters that only occur there keep their values.
        """

        def value(place: Place) -> float:
            return float(programs[place[0]].constants[place[1]])

        slots = [
            with_constants(slot, {node: value(places[0]) for node, places in by_node.items()})
            for slot, by_node in zip(self.composition.slots[: len(self.slots)], self.composition.places, strict=False)
        ]
        values = self.values.copy()
        for parameter, places in enumerate(self.composition.parameters):
            known = next((place for place in places if place[0] < len(programs)), None)
            if known is not None or not places:
                values[parameter] = math.nan if known is None else value(known)
        return replace(self, slots=tuple(slots), values=values)

    def with_slots(self, slots: Sequence[Program]) -> Self:
        """Return the same sides with other searched programs."""
        return replace(self, slots=tuple(slots))

    def with_candidate(self, index: int, unknown: Program, values: Mapping[str, float | None]) -> Self:
        """Return the sides with another unknown part at home in a side, and with other `values` of parameters by
        name."""
        known = [values.get(one.name) for one in self.template.parameters]
        pairs = zip(self.values.tolist(), known, strict=True)
        return replace(
            self,
            slots=(*self.slots[:index], unknown, *self.slots[index + 1 :]),
            values=np.array([old if new is None else new for old, new in pairs]),
        )

    def without_side(self, index: int, program: Program) -> Self:
        """Return the equations with a searched program instead of the side `index`."""
        old, name = self.template, self.template.equations[index]
        texts = {other: text for other, text in old.texts.items() if other != name}
        known = {one.name: one for one in old.parameters}
        used = {one.name for other in texts for one in map(old.parameters.__getitem__, old.parameters_in(other))}
        parameters = {name: one for name, one in known.items() if name in used}
        template = replace(read_template(texts, parameters, old.names, old.observed), equations=old.equations)
        values = dict(zip(known, self.values.tolist(), strict=True))
        slots = dict(zip(self.equations, self.slots, strict=True))
        parts = {one.label: slots[one.home] for one in old.unknowns}
        slots |= {one.home: parts[one.label] for one in template.unknowns if one.label != "?"} | {name: program}
        return replace(
            self,
            template=template,
            slots=tuple(slots[equation] for equation in self.equations),
            values=np.array([values[one.name] for one in template.parameters]),
        )

    @cached_property
    def _explicit(self) -> list[tuple[list[ExplicitCoefficients], Composition]]:
        """The ways in which constants may have been fitted: with factors of 1 in the slots as constants, and as they
        are written."""
        ways = [[make(slot) for slot in self.slots] for make in (make_coefficients_explicit, as_written)]
        return [(way, self.with_slots([one.program for one in way]).composition) for way in ways]

    def explicit_side(self, variable: str, origins: Sequence[int | None]) -> tuple[Program, IntArray] | None:
        """Return a side as it was fitted, and the indices of the fitted constants among its constants.

        `origins` are their numbers among the constants of the written side (None: a factor of 1). None if neither way
        fits to them.
        """
        index = self.template.equations.index(variable)
        numbers = {source: number for number, source in enumerate(self.composition.sources(index))}
        for explicit, composed in self._explicit:
            fitted = [*written_sources(composed.sources(index), explicit)]
            if [None if one is None else numbers[one] for _, one in fitted] == origins:
                return composed.programs[index], np.array([place for place, _ in fitted], np.int64)
        return None

    def describe(self, equation: Equation, index: int, before: Sequence[Constant] = ()) -> Equation:
        """Return an equation of a result with the side of this index.

        Its constants have no errors. Parameters have the bounds that they have in `before`, the constants of the side
        before its unknown parts changed.
        """
        given = equation.given
        assert given is not None
        program = self.programs[index]
        values = program.constants[constant_places(program)].tolist()
        bounds = {name: before[place].bounds for name, place in given.parameters.items() if place < len(before)}
        called = self.template.parameter_names(self.composition.sources(index))
        constants = [
            Constant(value=value, bounds=bounds.get(name or "")) for value, name in zip(values, called, strict=True)
        ]
        side = given.model_copy(
            update={
                "parameters": {name: place for place, name in enumerate(called) if name is not None},
                "unknowns": self.described_parts(index),
            }
        )
        update = {"given": side, "constants": tuple(constants), "complexity": len(program)}
        update |= {"expression": to_infix(program, self.template.names), "program": program.to_bytes().hex()}
        return equation.model_copy(update=update)

    def described_parts(self, index: int) -> tuple[UnknownPart, ...]:
        """Return the unknown parts of a side as a result has them."""
        names = self.template.names
        return tuple(
            UnknownPart(label=label, expression=to_infix(part, names), program=part.to_bytes().hex())
            for label, part in self.template.parts_of(self.equations[index], self.slots).items()
        )


def searched_parts(result: Result) -> dict[str, str]:
    """Return the labels of the unknown parts of a result by the equation under whose name they were searched."""
    return {one.home: one.label for one in GivenSides.of(result).template.unknowns}


class NamedSide(NamedTuple):
    """A side for display: a program over `names`, which are variables and parameters, and then over unknown parts.

    `parts` has the label and the program of each unknown part, by the index of its variable. If the user gave the side,
    it is displayed as it was written.
    """

    program: Program
    names: tuple[str, ...]
    parts: Mapping[int, tuple[str, Program]]
    is_given: bool


def named_side(equation: Equation | Observation, names: Sequence[str]) -> NamedSide:
    """Return the side of an equation, in the form in which the user gave it if it was given."""
    given = equation.given
    if given is None:
        return NamedSide(from_infix(equation.expression or "", names), tuple(names), {}, is_given=False)
    declared = {name: TemplateParameter(name) for name in given.parameters}
    home = equation.variable if isinstance(equation, Equation) else equation.column
    template = read_template({home: given.text}, declared, names)
    before = (*names, *(one.name for one in template.parameters))
    found = {part.label: (part.label, _part_program(part, names)) for part in given.unknowns}
    parts = {place: found[one.label] for place, one in enumerate(template.unknowns, len(before))}
    return NamedSide(template.sides[home], before, parts, is_given=True)


def with_parameter_names(equation: Equation | Observation, names: Sequence[str]) -> tuple[Program, tuple[str, ...]]:
    """Return a right-hand side with its parameters as variables, and the names of all variables."""
    program, given = program_of(equation, names), equation.given
    if given is None:
        return program, tuple(names)
    operators, left, constants = program.operators.copy(), program.left.copy(), constant_places(program)
    for number, place in enumerate(given.parameters.values()):
        operators[constants[place]], left[constants[place]] = VARIABLE, len(names) + number
    return replace(program, operators=operators, left=left), (*names, *given.parameters)


def over_variables(program: Program, places: Sequence[int]) -> Program:
    """Return a program over other variables; `places` has the new index of each variable."""
    left = [places[index] if code == VARIABLE else index for code, index, _, _ in program.nodes()]
    return replace(program, left=np.array(left, dtype=np.int16))


def _part_program(part: UnknownPart, names: Sequence[str]) -> Program:
    if part.program is None:
        return from_infix(part.expression, names)
    return Program.from_bytes(bytes.fromhex(part.program), len(names))


def fitted_parameters(result: Result) -> dict[str, Constant]:
    """Return the parameters in given sides of a result, and in columns that are computed from states, by name."""
    sides: list[Equation | Observation] = [*result.equations, *result.observations]
    given = [(one.given.parameters, one.constants) for one in sides if one.given is not None]
    return {name: constants[place] for places, constants in given for name, place in places.items()}


def _parameters(result: Result) -> dict[str, TemplateParameter]:
    """Return the parameters of a result, by name, with their bounds."""
    parameters = {}
    for name, constant in fitted_parameters(result).items():
        low, high = constant.bounds or (None, None)
        ends = -math.inf if low is None else low, math.inf if high is None else high
        parameters[name] = TemplateParameter(name, *ends)
    return parameters
