"""Alternative systems of equations for the same data, fitted and weighted.

Weights are Akaike's (Burnham & Anderson 2002, section 2.9), exp(-(misfit + k + k (k + 1)/(n - k - 1))) for k numbers
fitted to n (Hurvich & Tsai 1989). They count only the fit: an experiment should decide between models that differ so
far only in description length.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, islice
from typing import Final

import numpy as np

from atoll.experiments.fits import EquationSet, FitData, FittedEquations, fit_equations
from atoll_coordinator.model.criteria import constant_nats_of, system_length
from atoll_coordinator.result.result import Result
from atoll_core.errors import UsageError
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.operators import ADD, ARITY, CONSTANT, DIVIDE, INVERSE, MULTIPLY
from atoll_core.expression.program import Node, Program, ProgramBuilder, constant_places, live_nodes
from atoll_core.expression.text.parsing import from_infix

MOST_SYSTEMS: Final = 8
"""Systems that are kept: each pair is compared in every experiment."""
_MOST_FITTED: Final = 24
_PER_EQUATION: Final = 4
_LEAST_WEIGHT: Final = 0.01
"""Smallest weight over the best one: a system that is improbable to a hundredth needs no experiment."""
_LONGEST: Final = 10.0
"""Largest Δ description length of a candidate that is fitted again."""
_FIRST_SHARE: Final = 0.1
"""Initial value of a constant in a denominator, over the mean of the rest of it."""
_SAME: Final = 1e-3
"""Largest difference of misfits, in nats, of one function in two forms, or with a superfluous constant."""
_WANTED: Final = ("shown", "given")
"""Origins of systems that are candidates however badly they fit."""


@dataclass(frozen=True, eq=False)
class WeightedSystem:
    """A system fitted to the data: `nats` is ln of the best weight over its weight; weights sum to 1.

    `length` is the description length in nats, by which results choose equations.
    """

    fitted: FittedEquations
    origin: str
    nats: float
    weight: float
    length: float


def alternatives_of(
    result: Result, shown: FittedEquations, given: Sequence[Mapping[str, str]]
) -> tuple[WeightedSystem, ...]:
    """Return the displayed system and the systems that fit about as well, the best first.

    Candidates of the result replace equations of `shown` one at a time and in pairs; systems `given` are right-hand
    sides by state. Raises UsageError for a state without an equation, and for a system that cannot be read or
    simulated.
    """
    measured = shown.measured
    fits: list[tuple[FittedEquations, str]] = [(shown, "shown")]
    for texts in given:
        equations = _given(shown.equations, texts)
        fitted = fit_equations(measured, equations)
        if fitted is None:
            raise UsageError(f"the rival {', '.join(texts.values())} cannot be simulated along the data; give another")
        fits.append((fitted, "given"))
    for equations, origin in _systems(result, measured, shown.equations):
        fitted = fit_equations(measured, equations, shown.fit.starts)
        if fitted is not None and not ("denominator" in origin and _has_pole(fitted)):
            fits.append((fitted, origin))
    return _weighed(fits)


def _weighed(fits: Sequence[tuple[FittedEquations, str]]) -> tuple[WeightedSystem, ...]:
    lengths = [_half_akaike(fitted) for fitted, _ in fits]
    least = min(lengths)
    kept: list[tuple[float, FittedEquations, str]] = []
    ordered = sorted(zip(lengths, fits, strict=True), key=lambda entry: (entry[1][1] not in _WANTED, entry[0]))
    for nats, (fitted, origin) in ordered:
        is_plausible = nats - least <= -math.log(_LEAST_WEIGHT) and len(kept) < MOST_SYSTEMS
        is_new = all(abs(fitted.misfit - other.misfit) > _SAME for _, other, _ in kept)
        if origin in _WANTED or (is_plausible and is_new):
            kept.append((nats, fitted, origin))
    kept.sort(key=lambda rival: rival[0])
    weights = np.exp([least - nats for nats, *_ in kept])
    shares = (weights / weights.sum()).tolist()
    rivals = []
    for (nats, fitted, origin), share in zip(kept, shares, strict=True):
        constant_nats = constant_nats_of(float(fitted.measured.rows))
        length = system_length(fitted.misfit, fitted.equations.programs, len(fitted.values), constant_nats)
        rivals.append(WeightedSystem(fitted, origin, nats - least, share, length))
    return tuple(rivals)


def weighed_pair(first: FittedEquations, second: FittedEquations) -> tuple[float, float]:
    """Return the log odds for the first of two systems fitted to the same data, and the Δ description length.

    Both in nats: the odds count the fit alone, the description length of the second less the first also the equations.
    """
    rivals = {id(rival.fitted): rival for rival in _weighed([(first, "shown"), (second, "given")])}
    one, other = rivals[id(first)], rivals[id(second)]
    return other.nats - one.nats, other.length - one.length


def half_akaike(misfit: float, count: int, numbers: float) -> float:
    """Return half of Akaike's criterion, corrected for few rows, for `count` numbers fitted to `numbers`, in nats."""
    return misfit + count + count * (count + 1.0) / max(numbers - count - 1.0, 1.0)


def _half_akaike(fitted: FittedEquations) -> float:
    count = len(fitted.values) + fitted.fit.starts.size
    return half_akaike(fitted.misfit, count, float(fitted.measured.independent.sum()))


def _given(shown: EquationSet, texts: Mapping[str, str]) -> EquationSet:
    for name, text in texts.items():
        if name not in shown.variables:
            raise UsageError(f"a rival names '{name}'; there are equations of {', '.join(shown.variables)}")
        place = shown.variables.index(name)
        shown = replace(shown, fixed=shown.fixed - {place}).exchanged(place, from_infix(text, shown.names))
    return shown


def _systems(result: Result, measured: FitData, shown: EquationSet) -> Iterator[tuple[EquationSet, str]]:
    """Yield systems in which one or two of the displayed equations are replaced."""
    options: list[tuple[int, Program, str]] = []
    for place, entry in enumerate(result.equations):
        if place in shown.fixed:
            continue
        others = sorted(
            (candidate.nats, candidate.expression)
            for candidate in entry.candidates
            if not candidate.selected and candidate.nats is not None and candidate.nats <= _LONGEST
        )
        options += [(place, from_infix(text, shown.names), "candidate") for _, text in others[:_PER_EQUATION]]
        options += [
            (place, program, "denominator") for program in without_poles(shown.programs[place], shown, measured)
        ]
    for place, program, origin in options:
        yield shown.exchanged(place, program), origin
    pairs = (pair for pair in combinations(options, 2) if pair[0][0] != pair[1][0])
    for (place, first, origin), (other, second, other_origin) in islice(pairs, max(_MOST_FITTED - len(options), 0)):
        origins = " and ".join(sorted({origin, other_origin}))
        yield shown.exchanged(place, first).exchanged(other, second), origins


def without_poles(program: Program, equations: EquationSet, measured: FitData) -> Iterator[Program]:
    """Yield the program with another denominator: for n/d n/(d + c) and n d/(d**2 + c), for n/(d + c) only the latter.

    Where d is never near 0 in the data, these fit as well as n/d, and they have no pole.
    """
    nodes = program.nodes()
    for index, (code, left, right, _) in enumerate(nodes):
        if code not in (DIVIDE, INVERSE):
            continue
        whole = right if code == DIVIDE else left
        below = _without_constant(nodes, whole)
        measurements = measured.measurements  # the denominator over the data must not change its sign
        rows = [measurements.variables.index(name) for name in equations.names]
        points = np.ascontiguousarray(np.concatenate([measurements.smoothed, measurements.inputs])[rows])
        values = values_of(Program.of(live_nodes(program.nodes(), below)), points)
        is_one_sided = np.all(values > 0.0) or np.all(values < 0.0)
        size = float(values.mean()) if is_one_sided and np.isfinite(values).all() and np.ptp(values) > 0.0 else None
        if size is not None:
            if below == whole:
                yield _rebuilt(program, index, below, _FIRST_SHARE * size, is_square=False)
            yield _rebuilt(program, index, below, _FIRST_SHARE * size * abs(size), is_square=True)


def _without_constant(nodes: Sequence[Node], node: int) -> int:
    """Return the other operand of a sum with a constant; the node itself otherwise."""
    code, left, right, _ = nodes[node]
    if code == ADD and nodes[left][0] == CONSTANT:
        return right
    return left if code == ADD and nodes[right][0] == CONSTANT else node


def _rebuilt(program: Program, index: int, divisor: int, constant: float, *, is_square: bool) -> Program:
    """Return the program with the sum of a part, or its square, and a constant as denominator at a node."""
    nodes, builder = program.nodes(), ProgramBuilder()
    new: list[int] = []
    for place, (code, left, right, value) in enumerate(nodes):
        if place != index:
            new_left, new_right = (new[left], new[right] if ARITY[code] == 2 else 0) if ARITY[code] else (left, right)
            new.append(builder.append(code, new_left, new_right, value))
            continue
        below, above = new[divisor], new[left] if code == DIVIDE else None
        added = builder.append(CONSTANT, value=constant)
        if is_square:
            above = below if above is None else builder.append(MULTIPLY, above, below)
            below = builder.append(MULTIPLY, below, below)
        whole = builder.append(ADD, below, added)
        new.append(builder.append(INVERSE, whole) if above is None else builder.append(DIVIDE, above, whole))
    return builder.program(new[-1])


def _has_pole(fitted: FittedEquations) -> bool:
    """Tell whether the constant added to a denominator got the sign with which it vanishes somewhere."""
    programs = fitted.fit.system.programs[-len(fitted.equations.programs) :]
    for before, after in zip(fitted.equations.explicit, programs, strict=True):
        nodes = after.nodes()
        divisors = {right if code == DIVIDE else left for code, left, right, _ in nodes if code in (DIVIDE, INVERSE)}
        added = {place for divisor in divisors if nodes[divisor][0] == ADD for place in nodes[divisor][1:3]}
        for place in constant_places(after):
            begun, ended = float(before.program.constants[place]), float(after.constants[place])
            if place in added and begun * ended <= 0.0:
                return True
    return False
