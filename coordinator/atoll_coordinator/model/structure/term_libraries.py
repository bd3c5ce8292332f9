"""Candidates beside those of the search: libraries of terms, from which the least significant go one after another.

A sum of all products of variables up to some degree, with or without sines and cosines, is fitted to one state's
trajectories, the others as smoothed; then the term of least coefficient over standard error is left out, and so on
(backward elimination by Wald's test). Every sum on the way is a candidate: what a greedy search by derivative error
does not reach, or what it buries in terms that describe the smoother's errors.
"""

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, combinations_with_replacement
from typing import Final

import numpy as np

from atoll.data.dataset import FloatArray, Problem
from atoll.expression.operators import ADD, ARITY, CONSTANT, COS, DIVIDE, MULTIPLY, SIN, SUBTRACT, VARIABLE
from atoll.expression.program import Program
from atoll_coordinator.model.selection.comparison import Contest, Standing, covariance
from atoll_coordinator.model.structure.rewriting import Node, tidied

MOST_TERMS: Final = 24
"""Larger libraries are not tried."""


@dataclass(frozen=True)
class Divisor:
    """What a term is divided by: a variable (index) or its square (`power` 2), and a constant added unless that is 0.

    `shift` is where the fit of that constant begins; equal divisors have one constant in common.
    """

    variable: int
    power: int = 1
    shift: float = 0.0


@dataclass(frozen=True)
class Factor:
    """A variable (index), or its sum or difference (`join`) with an`other`; as it is, or its sine or cosine.

    Instead of a factor there may be a `divisor`.
    """

    variable: int
    function: int | None = None
    other: int | None = None
    join: int = SUBTRACT
    divisor: Divisor | None = None


Term = tuple[Factor, ...]
"""A product."""


def libraries(variables: Sequence[int], operators: Collection[int]) -> Iterator[list[Term]]:
    """Yield libraries over these variables, as far as the operators (codes) allow them, the constant term first.

    Powers and products up to the second or third degree; with sines and cosines; products of these; and sines and
    cosines of sums and differences, by which phases are coupled.
    """
    if not {ADD, MULTIPLY} <= set(operators):
        return
    plain = [Factor(variable) for variable in variables]
    waves = [Factor(variable, code) for variable in variables for code in (SIN, COS)]
    coupled = [
        Factor(one, code, other, join)
        for one, other in combinations(variables, 2)
        for join in (SUBTRACT, ADD)
        for code in (SIN, COS)
    ]
    found = [_powers(plain, 2), _powers(plain, 3)]
    if {SIN, COS} <= set(operators):
        pairs: list[Term] = [*combinations(waves, 2)]
        single: list[Term] = [(wave,) for wave in waves]
        found += [[*_powers(plain, 2), *single], [(), *single, *pairs]]
        if SUBTRACT in operators:
            found.append([(), *single, *((wave,) for wave in coupled)])
    yield from (terms for terms in found if len(terms) <= MOST_TERMS)


def fractions(variables: Sequence[int], operators: Collection[int], sizes: Sequence[float]) -> Iterator[list[Term]]:
    """Yield libraries with quotients, the constant term first, as far as the operators (codes) allow them.

    Powers and products up to the second degree, beside them what saturates or fades with one variable v: products of
    v, or v squared, over a constant and the same (Monod's and Holling's laws), the constant of all of them being the
    same one; and sines, cosines and variables over v.

    Args:
        variables: indices of the variables.
        operators: codes that may be used.
        sizes: the size of each variable, by index; constants of denominators begin there.
    """
    if not {ADD, MULTIPLY, DIVIDE} <= set(operators):
        return
    plain = [Factor(variable) for variable in variables]
    for variable in variables:
        for power in (1, 2):
            under = Factor(variable, divisor=Divisor(variable, power, sizes[variable] ** power))
            own, others = (Factor(variable), under), [(each,) for each in plain if each != Factor(variable)]
            mixed: list[Term] = [(*other, *own) for other in others]
            for found in ([*mixed], [own, *mixed]):
                if found and len(found) + len(_powers(plain, 2)) <= MOST_TERMS:
                    yield [*_powers(plain, 2), *found]
    if {SIN, COS} <= set(operators):
        waves: list[Term] = [(Factor(variable, code),) for variable in variables for code in (SIN, COS)]
        for variable in variables:
            over = Factor(variable, divisor=Divisor(variable))
            numerators: list[Term] = [(), *((each,) for each in plain if each != Factor(variable)), *waves]
            yield [(), *((each,) for each in plain), *waves, *((*term, over) for term in numerators)]


def _powers(factors: Sequence[Factor], degree: int) -> list[Term]:
    return [term for order in range(degree + 1) for term in combinations_with_replacement(factors, order)]


def sum_of(terms: Sequence[Term], coefficients: Sequence[float]) -> Program:
    """Return the tidied program of the sum of `terms` with these coefficients, none of which is 0, 1 or -1."""
    nodes: list[Node] = []
    total: int | None = None
    for term, coefficient in zip(terms, coefficients, strict=True):
        nodes.append((CONSTANT, 0, 0, float(coefficient)))
        part = len(nodes) - 1
        for factor in term:
            _put(factor, nodes)
            nodes.append((DIVIDE if factor.divisor else MULTIPLY, part, len(nodes) - 1, 0.0))
            part = len(nodes) - 1
        if total is not None:
            nodes.append((ADD, total, part, 0.0))
        total = len(nodes) - 1
    codes, lefts, rights, values = zip(*nodes, strict=True)
    return tidied(
        Program(np.array(codes, np.int8), np.array(lefts, np.int16), np.array(rights, np.int16), np.array(values))
    )


def _put(factor: Factor, nodes: list[Node]) -> None:
    """Append the nodes of a factor, or of what a term is divided by."""
    nodes.append((VARIABLE, factor.variable, 0, 0.0))
    if factor.divisor is not None:
        if factor.divisor.power == 2:
            nodes.append((MULTIPLY, len(nodes) - 1, len(nodes) - 1, 0.0))
        if factor.divisor.shift:
            nodes.append((CONSTANT, 0, 0, factor.divisor.shift))
            nodes.append((ADD, len(nodes) - 2, len(nodes) - 1, 0.0))
    if factor.other is not None:
        nodes.append((VARIABLE, factor.other, 0, 0.0))
        nodes.append((factor.join, len(nodes) - 2, len(nodes) - 1, 0.0))
    if factor.function is not None:
        nodes.append((factor.function, len(nodes) - 1, 0, 0.0))


def column_of(term: Term, inputs: FloatArray) -> FloatArray:
    """Return the values of a term (R,) at `inputs` (V, R)."""
    column = np.ones(inputs.shape[1])
    for factor in term:
        values = inputs[factor.variable]
        if factor.other is not None:
            values = values + inputs[factor.other] if factor.join == ADD else values - inputs[factor.other]
        if factor.function is not None:
            values = np.sin(values) if factor.function == SIN else np.cos(values)
        if factor.divisor is not None:
            with np.errstate(all="ignore"):
                values = 1.0 / (values**factor.divisor.power + factor.divisor.shift)
        column = column * values
    return column


def eliminated(contest: Contest, problem: Problem, terms: list[Term], steps: int = 6) -> list[Standing]:
    """Return the fits on the way from the sum of all `terms` to a single one; `contest` is for this state alone.

    Nothing where a term has no value somewhere.
    """
    found: list[Standing] = []
    while terms:
        columns = np.array([column_of(term, problem.inputs) for term in terms])
        if not np.isfinite(columns).all():
            break
        scales = [max(float(np.abs(column).max()), 1e-300) for column in columns]
        coefficients = _fitted(columns, scales, problem.target.values)
        standing = contest.stand([sum_of(terms, coefficients)], steps, (10,))
        if standing is not None:
            found.append(standing)
        index = _least(standing, columns, coefficients)
        terms = _moved([*terms[:index], *terms[index + 1 :]], standing)
    return found


def _moved(terms: list[Term], standing: Standing | None) -> list[Term]:
    """Return the terms with the constant of their denominators where the fit has left it, if that is positive."""
    if standing is None:
        return terms
    program = standing.programs[0]
    shifts = [float(program.constants[place]) for place in sorted(_below(program))]
    if len(shifts) != 1 or not 0.0 < shifts[0] < math.inf:
        return terms

    def moved(factor: Factor) -> Factor:
        divisor = factor.divisor
        return replace(factor, divisor=replace(divisor, shift=shifts[0])) if divisor and divisor.shift else factor

    return [tuple(map(moved, term)) for term in terms]


def _below(program: Program) -> set[int]:
    """Return the nodes of the constants that denominators are made of."""
    found: set[int] = set()
    for index in range(len(program) - 1, -1, -1):
        code = int(program.operators[index])
        arguments = [int(program.left[index]), int(program.right[index])][: ARITY[code]]
        if index in found:
            found |= set(arguments)
        elif code == DIVIDE:
            found.add(arguments[1])
    return {index for index in found if program.operators[index] == CONSTANT}


def _fitted(columns: FloatArray, scales: Sequence[float], target: FloatArray) -> list[float]:
    """Return least-squares coefficients, a little off the numbers that would not stay."""
    unit = columns / np.array(scales)[:, None]
    solution, *_ = np.linalg.lstsq(unit.T, target, rcond=1e-10)
    return [float(value / scale) + 1e-9 * float(np.abs(target).max()) / scale
            for value, scale in zip(solution, scales, strict=True)]  # fmt: skip


def _least(standing: Standing | None, columns: FloatArray, coefficients: Sequence[float]) -> int:
    """Return the index of the least significant term: by its fit, without one by its size."""
    by_size = int(np.argmin(np.abs(coefficients) * columns.std(axis=1)))
    if standing is None:
        return by_size
    its = standing.shot.system
    is_factor = ~np.isin(its.places, sorted(_below(standing.programs[0])))
    if int(is_factor.sum()) != len(coefficients):
        return by_size
    errors = np.sqrt(np.maximum(np.diag(covariance(standing.shot))[is_factor], 1e-300))
    return int(np.argmin(np.abs(its.values[is_factor]) / errors))
