"""Whole right-hand sides of equations with a template, as they are shown: which constant is which. Pure.

Until here, each equation with an unknown part had one searched program, its unknown part. `compose_equations` puts the
programs into the template and tells for each constant of a whole side where its estimate comes from.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from atoll_coordinator.result.equations import SimpleNumber
from atoll_core.expression.program import Program
from atoll_core.expression.template import EquationTemplate, written_sources
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
    composed, written = template.compose([one.program for one in explicit], none), template.compose(shown, none)
    sides = list[ExplicitCoefficients]()
    all_simple, names = list[tuple[SimpleNumber | None, ...]](), list[tuple[str | None, ...]]()
    for index, program in enumerate(composed.programs):
        before, after = composed.sources(index), written.sources(index)
        numbers = {source: number for number, source in enumerate(after)}
        origins = [None if one is None else numbers[one] for _, one in written_sources(before, explicit)]
        homes = sorted({source.home for source in before if source.home is not None})
        terms = [term for home in homes for term in explicit[home].terms]
        sides.append(ExplicitCoefficients(program, tuple(origins), tuple(terms)))
        all_simple.append(tuple(
            None if one.home is None or not simple[one.home] else simple[one.home][one.number] for one in after
        ))  # fmt: skip
        names.append(template.parameter_names(after))
    return ComposedEquations(tuple(sides), tuple(all_simple), tuple(names))
