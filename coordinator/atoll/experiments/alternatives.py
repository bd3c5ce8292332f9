"""Alternative systems of equations for the same data, fitted and weighted.

The alternatives come from the candidates of the result and from changed denominators. Each is fitted again with all
constants free. The weights are Akaike weights (Burnham & Anderson 2002, section 2.9). With the correction for few rows
(Hurvich & Tsai 1989), the weight is proportional to exp(-(misfit + k + k (k + 1)/(n - k - 1))) for k values fitted to n
independent rows. Weights use only the fit and ignore the lengths of the equations: an experiment should decide between
models that fit equally well and differ only in description length.

Doubtful: the list of alternatives is not complete. A law that the search did not propose has no weight.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, islice
from typing import Final

import numpy as np

from atoll.experiments.fits import EquationSet, EquationSetFit, FitData, fit_equations
from atoll_coordinator.model.description_length import constant_nats_of, system_length
from atoll_coordinator.result.result import Result
from atoll_core.errors import UsageError
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.operators import ADD, ARITY, CONSTANT, DIVIDE, INVERSE, MULTIPLY
from atoll_core.expression.program import Node, Program, ProgramBuilder, constant_places, live_nodes
from atoll_core.expression.text.parsing import from_infix

MOST_SYSTEMS: Final = 8
"""Largest number of systems: each pair of systems is compared in every experiment."""
_MOST_FITTED: Final = 24
_PER_EQUATION: Final = 4
_LEAST_WEIGHT: Final = 0.01
"""Smallest weight, relative to the largest weight. A system with a smaller weight needs no experiment."""
_LONGEST: Final = 10.0
"""Largest Δ description length of a candidate that is fitted again."""
_FIRST_SHARE: Final = 0.1
"""Initial value of a constant in a denominator, divided by the mean of the other part of the denominator."""
_EQUAL_MISFIT: Final = 1e-3
"""Largest difference of misfits, in nats, between two forms of the same function."""
_ALWAYS_KEPT: Final = ("shown", "given")
"""Origins of systems that are always kept, even with a bad fit."""


@dataclass(frozen=True, eq=False)
class WeightedSystem:
    """A system fitted to the data, with its Akaike `weight`; all weights sum to 1.

    `nats` is the logarithm of the largest weight divided by this weight. `length` is the description length in nats;
    jobs choose equations by their description length.
    """

    fitted: EquationSetFit
    origin: str
    nats: float
    weight: float
    length: float


def alternatives_of(
    result: Result, displayed: EquationSetFit, given: Sequence[Mapping[str, str]]
) -> tuple[WeightedSystem, ...]:
    """Return the `displayed` system and the systems that fit about as well, the best first.

    Candidates of the result replace one or two equations of `displayed`. The systems `given` by the user are right-hand
    sides by state. Raises UsageError for a state without an equation, and for a system that cannot be parsed or
    simulated.
    """
    measured = displayed.measured
    fits: list[tuple[EquationSetFit, str]] = [(displayed, "shown")]
    for texts in given:
        equations = _replace_equations(displayed.equations, texts)
        fitted = fit_equations(measured, equations)
        if fitted is None:
            named = ", ".join(texts.values())
            raise UsageError(f"the alternative model {named} cannot be simulated along the data; give another one")
        fits.append((fitted, "given"))
    for equations, origin in _systems(result, measured, displayed.equations):
        fitted = fit_equations(measured, equations, displayed.fit.starts)
        if fitted is not None and not ("denominator" in origin and _has_pole(fitted)):
            fits.append((fitted, origin))
    return _weigh(fits)


def _weigh(fits: Sequence[tuple[EquationSetFit, str]]) -> tuple[WeightedSystem, ...]:
    lengths = [_half_akaike(fitted) for fitted, _ in fits]
    least = min(lengths)
    kept: list[tuple[float, EquationSetFit, str]] = []
    ordered = sorted(zip(lengths, fits, strict=True), key=lambda entry: (entry[1][1] not in _ALWAYS_KEPT, entry[0]))
    for nats, (fitted, origin) in ordered:
        is_plausible = nats - least <= -math.log(_LEAST_WEIGHT) and len(kept) < MOST_SYSTEMS
        is_new = all(abs(fitted.misfit - other.misfit) > _EQUAL_MISFIT for _, other, _ in kept)
        if origin in _ALWAYS_KEPT or (is_plausible and is_new):
            kept.append((nats, fitted, origin))
    kept.sort(key=lambda rival: rival[0])
    weights = np.exp([least - nats for nats, *_ in kept])
    shares = (weights / weights.sum()).tolist()
    rivals = []
    for (nats, fitted, origin), share in zip(kept, shares, strict=True):
        constant_nats = constant_nats_of(float(fitted.measured.rows))
        length = system_length(
            fitted.misfit,
            fitted.equations.given.programs,
            len(fitted.values),
            constant_nats,
        )
        rivals.append(WeightedSystem(fitted, origin, nats - least, share, length))
    return tuple(rivals)


def weigh_pair(first: EquationSetFit, second: EquationSetFit) -> tuple[float, float]:
    """Return the log odds for the first of two systems, and the Δ description length (second minus first), in nats.

    Both systems are fitted to the same data. The odds use only the fit; description lengths also count the equations.
    """
    rivals = {id(rival.fitted): rival for rival in _weigh([(first, "shown"), (second, "given")])}
    one, other = rivals[id(first)], rivals[id(second)]
    return other.nats - one.nats, other.length - one.length


def half_akaike(misfit: float, count: int, numbers: float) -> float:
    """Return half of Akaike's criterion in nats, corrected for few rows: `count` values fitted to `numbers` rows."""
    return misfit + count + count * (count + 1.0) / max(numbers - count - 1.0, 1.0)


def _half_akaike(fitted: EquationSetFit) -> float:
    count = len(fitted.values) + fitted.fitted_starts
    return half_akaike(fitted.misfit, count, float(fitted.measured.independent.sum()))


def _replace_equations(displayed: EquationSet, texts: Mapping[str, str]) -> EquationSet:
    for name, text in texts.items():
        if name not in displayed.variables:
            known = f"the model has equations of {', '.join(displayed.variables)}"
            raise UsageError(f"an alternative model has an equation of '{name}', but {known}")
        place = displayed.variables.index(name)
        displayed = replace(displayed, fixed=displayed.fixed - {place}).with_equation(
            place, from_infix(text, displayed.names)
        )
    return displayed


def _systems(result: Result, measured: FitData, displayed: EquationSet) -> Iterator[tuple[EquationSet, str]]:
    """Yield systems in which one or two of the displayed equations are replaced."""
    options: list[tuple[int, Program, str]] = []
    for place, entry in enumerate(result.equations):
        if place in displayed.fixed or not displayed.is_searched(place):
            continue
        others = sorted(
            (candidate.nats, candidate.unknown or candidate.expression)
            for candidate in entry.candidates
            if not candidate.selected and candidate.nats is not None and candidate.nats <= _LONGEST
        )
        options += [(place, from_infix(text, displayed.names), "candidate") for _, text in others[:_PER_EQUATION]]
        options += [
            (place, program, "denominator") for program in without_poles(displayed.programs[place], displayed, measured)
        ]
    for place, program, origin in options:
        yield displayed.with_searched(place, program), origin
    pairs = (pair for pair in combinations(options, 2) if pair[0][0] != pair[1][0])
    for (place, first, origin), (other, second, other_origin) in islice(pairs, max(_MOST_FITTED - len(options), 0)):
        origins = " and ".join(sorted({origin, other_origin}))
        yield displayed.with_searched(place, first).with_searched(other, second), origins


def without_poles(program: Program, equations: EquationSet, measured: FitData) -> Iterator[Program]:
    """Yield programs with another denominator that has no pole.

    For n/d these are n/(d + c) and n d/(d**2 + c); for n/(d + c) only n d/(d**2 + c). If d is never near 0 in the data,
    they fit as well as n/d.
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
                yield _with_denominator(program, index, below, _FIRST_SHARE * size, is_square=False)
            yield _with_denominator(program, index, below, _FIRST_SHARE * size * abs(size), is_square=True)


def _without_constant(nodes: Sequence[Node], node: int) -> int:
    """Return the other operand if `node` is a sum with a constant, otherwise `node`."""
    code, left, right, _ = nodes[node]
    if code == ADD and nodes[left][0] == CONSTANT:
        return right
    return left if code == ADD and nodes[right][0] == CONSTANT else node


def _with_denominator(program: Program, index: int, divisor: int, constant: float, *, is_square: bool) -> Program:
    """Return the program with a new denominator at node `index`: `divisor`, or its square, plus a constant."""
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


def _has_pole(fitted: EquationSetFit) -> bool:
    """Tell whether the fit gave a constant in a denominator the other sign, so that the denominator can be 0."""
    programs = fitted.fit.system.programs[-len(fitted.equations.programs) :]
    for before, after in zip(fitted.equations.whole.programs, programs, strict=True):
        nodes = after.nodes()
        divisors = {right if code == DIVIDE else left for code, left, right, _ in nodes if code in (DIVIDE, INVERSE)}
        added = {place for divisor in divisors if nodes[divisor][0] == ADD for place in nodes[divisor][1:3]}
        for place in constant_places(after):
            begun, ended = float(before.constants[place]), float(after.constants[place])
            if place in added and begun * ended <= 0.0:
                return True
    return False
