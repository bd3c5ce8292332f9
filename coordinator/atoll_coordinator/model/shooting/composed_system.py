"""The system of equations that were composed with a template: which constants are fitted, and which are one number.
Pure.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from atoll_coordinator.model.shooting.system import OdeSystem, Place, SearchedParts, system_of
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import Program
from atoll_core.expression.template import Composition, EquationTemplate

Ends = tuple[float, float]
"""Lower and upper bound."""


def composed_system(  # noqa: PLR0913, the arguments of `system_of`, and the template
    template: EquationTemplate, composition: Composition, names: Sequence[str], variables: Sequence[str],
    leading: Sequence[Program], fixed: Sequence[Collection[int]], bounds: Mapping[Place, Ends], *,
    are_parameters_fixed: bool = False,
) -> OdeSystem:  # fmt: skip
    """Return the system of composed equations, with their constants fitted within `bounds`.

    A parameter, or a constant of an unknown part, that occurs at several places is one fitted number. Programs of the
    composition that follow the equations are columns that are computed from states.

    Args:
        template: the template of the equations.
        composition: the equations, composed with the template.
        names: names of a program's variables, by index.
        variables: as in `system_of`.
        leading: equations that come before the equations of the template.
        fixed: for each searched program, the nodes whose constants are not fitted.
        bounds: bounds on constants of the composed equations, in addition to the bounds of parameters.
        are_parameters_fixed: whether no parameter is fitted.
    """
    held: list[set[int]] = [set(nodes) for nodes in composition.fixed]
    not_fitted = [
        place
        for nodes, places in zip(fixed, composition.places, strict=False)
        for node in nodes
        for place in places.get(node, ())
    ]
    not_fitted += [place for places in composition.parameters for place in places] if are_parameters_fixed else []
    for equation, node in not_fitted:
        held[equation].add(node)
    before, equations = len(leading), len(fixed)
    programs, columns = [*leading, *composition.programs], len(composition.programs) - equations
    system = system_of(programs, names, variables, [*[set[int]()] * before, *held], columns)
    system = replace(system, parts=_searched_parts(composition, system, before, equations))
    several = [places for by_node in composition.places for places in by_node.values()] + [*composition.parameters]
    shared = {
        places: tuple((place, 1.0) for place in places)
        for places in several
        if len(places) > 1 and places[0][1] not in held[places[0][0]]
    }
    lower, upper = _ranges(template, composition, system, before, bounds)
    if shared:
        system = system.sharing_numbers(system.constants[None], shared.values(), before)
        if system.sharing is not None and lower is not None and upper is not None:
            lower, upper = system.sharing.ranges(lower, upper)
    system = replace(system, lower=lower, upper=upper).in_logarithms()
    return system.with_values(system.values)


def _searched_parts(composition: Composition, system: OdeSystem, before: int, equations: int) -> SearchedParts:
    firsts = system.firsts[before:]
    slots = composition.slots[:equations]
    nodes = [np.full(len(slot), -1, np.int64) for slot in slots]
    for own, places in zip(nodes, composition.places, strict=False):
        for node, (first, *_) in places.items():
            own[node] = firsts[first[0]] + first[1]
    parameters = np.array(
        [firsts[places[0][0]] + places[0][1] if places else -1 for places in composition.parameters], np.int64
    )
    return SearchedParts(slots, tuple(nodes), parameters, composition.given)


def _ranges(
    template: EquationTemplate, composition: Composition, system: OdeSystem, before: int, bounds: Mapping[Place, Ends]
) -> tuple[FloatArray, FloatArray] | tuple[None, None]:
    """Return bounds (P,) on the fitted constants; None without bounds."""
    known = dict(bounds)
    for parameter, places in zip(template.parameters, composition.parameters, strict=True):
        known |= dict.fromkeys(places, (parameter.lower, parameter.upper))
    pairs = [known.get(place, (-math.inf, math.inf)) for place in system.fitted_constants(before)]
    ends = np.array(pairs).reshape(-1, 2)
    return (None, None) if np.isinf(ends).all() else (ends[:, 0].copy(), ends[:, 1].copy())
