"""Whole right-hand sides of equations with a template, as they are shown: which constant is which. Pure.

Until here, each equation with an unknown part had one searched program, its unknown part. `compose_equations` puts the
programs into the template and tells for each constant of a whole side where its estimate comes from.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from atoll_coordinator.result.equations import SimpleNumber
from atoll_core.expression.program import Program, constant_places
from atoll_core.expression.template import Composition, EquationTemplate
from atoll_core.expression.unit_coefficients import ExplicitCoefficients

SimpleNumbers = Sequence[SimpleNumber | None]


@dataclass(frozen=True, eq=False)
class ComposedEquations:
    """Whole right-hand sides (D), then the measured columns that are computed from states (M).

    `explicit` are the sides with written factors of one, whose `origins` only count fitted constants. `simple` has the
    simple number near each constant of the sides. `names` has the name of each constant that is a parameter.
    """

    explicit: tuple[ExplicitCoefficients, ...]
    simple: tuple[tuple[SimpleNumber | None, ...], ...]
    names: tuple[tuple[str | None, ...], ...]


def compose_equations(
    template: EquationTemplate, explicit: Sequence[ExplicitCoefficients], shown: Sequence[Program],
    simple: Sequence[SimpleNumbers],
) -> ComposedEquations:  # fmt: skip
    """Return the whole sides of searched programs.

    Args:
        template: the template of the equations.
        explicit: the searched programs with written factors of one.
        shown: the searched programs as they are shown.
        simple: for each of `shown`, the simple number near each constant, or nothing.
    """
    none = np.zeros(len(template.parameters))
    composer = _Composer(
        template, explicit, shown, simple,
        template.compose([one.program for one in explicit], none), template.compose(shown, none),
    )  # fmt: skip
    sides = [composer.side(index) for index in range(len(template.equations))]
    return ComposedEquations(*(tuple(parts) for parts in zip(*sides, strict=True)))


@dataclass(frozen=True, eq=False)
class _Composer:
    template: EquationTemplate
    coefficients: Sequence[ExplicitCoefficients]
    shown: Sequence[Program]
    simple: Sequence[SimpleNumbers]
    explicit: Composition
    written: Composition

    def side(self, index: int) -> tuple[ExplicitCoefficients, tuple[SimpleNumber | None, ...], tuple[str | None, ...]]:
        """Return one side, the simple numbers near its constants, and the names of its parameters."""
        numbers = {node: number for number, node in enumerate(constant_places(self.written.programs[index]))}
        origins, terms = dict[int, int | None](), list[Program]()
        simple, names = dict[int, SimpleNumber | None](), dict[int, str]()
        for home, coefficients in self._searched():
            here = list(self._constants(index, home))
            for node, origin in here:
                origins[node] = None if origin is None else numbers[self._written_node(index, home, origin)]
                if origin is not None and self.simple[home]:
                    simple[numbers[self._written_node(index, home, origin)]] = self.simple[home][origin]
            terms += coefficients.terms if here else ()
        for place, parameter in enumerate(self.template.parameters):
            for node in _nodes_in(index, self.explicit.parameters[place]):
                number = numbers[next(_nodes_in(index, self.written.parameters[place]))]
                origins[node], names[number] = number, parameter.name
        program = self.explicit.programs[index]
        ordered = tuple(origins[node] for node in sorted(origins))
        constants = range(len(numbers))
        return (
            ExplicitCoefficients(program, ordered, tuple(terms)),
            tuple(simple.get(number) for number in constants),
            tuple(names.get(number) for number in constants),
        )

    def _searched(self) -> Iterator[tuple[int, ExplicitCoefficients]]:
        for home, name in enumerate(self.template.equations):
            if not self.template.is_given(name):
                yield home, self.coefficients[home]

    def _constants(self, index: int, home: int) -> Iterator[tuple[int, int | None]]:
        """Yield the nodes of a side that hold constants of a searched program, each with its number among the constants
        as they are shown (None: a factor of one)."""
        coefficients = self.coefficients[home]
        for node, origin in zip(constant_places(coefficients.program), coefficients.origins, strict=True):
            for place in _nodes_in(index, self.explicit.places[home].get(node, ())):
                yield place, origin

    def _written_node(self, index: int, home: int, origin: int) -> int:
        node = constant_places(self.shown[home])[origin]
        return next(_nodes_in(index, self.written.places[home][node]))


def _nodes_in(index: int, places: Sequence[tuple[int, int]]) -> Iterator[int]:
    return (node for equation, node in places if equation == index)
