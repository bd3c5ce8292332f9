"""Backward elimination: the least significant terms of a library leave a sum one after another (Wald's test).

The sum of all terms is fitted to one state's trajectories, the others as smoothed; then the term of least coefficient
over standard error is left out, and so on. Every sum on the way is a candidate.
"""

import math
from collections.abc import Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np

from atoll_coordinator.model.batches import BatchFunction
from atoll_coordinator.model.least_squares import coefficients_of
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.fit_batches import ComparisonParts, FitOrder, FitSummary
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.shooting.trajectory_fit import covariance
from atoll_coordinator.model.structure.term_libraries import sum_of
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray, Problem
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.operators import ADD, ARITY, CONSTANT, DIVIDE
from atoll_core.expression.program import Expression, Program


@dataclass(frozen=True, eq=False)
class EliminationParts:
    """A comparison for one state alone, and the problem by which terms are fitted first."""

    comparison: ComparisonParts
    problem: Problem


@dataclass(frozen=True, eq=False)
class Eliminated:
    """The programs on the way, as they were before the fit, a summary of each fit, and the work of all."""

    programs: tuple[Program, ...]
    summaries: tuple[FitSummary, ...]
    work: int


_Eliminating = tuple[ModelComparison, Problem]


def _eliminated(within: _Eliminating, terms: tuple[Expression, ...]) -> Eliminated:
    comparison, problem = within
    before = comparison.estimator.counted
    models = eliminated(comparison, problem, list(terms))
    work = comparison.estimator.counted - before
    summaries = tuple(comparison.summary(_ORDER, model) for model in models)
    return Eliminated(tuple(model.fit.system.equations[-1] for model in models), summaries, work)


def _built(parts: EliminationParts) -> _Eliminating:
    return ModelComparison.of_parts(parts.comparison), parts.problem


_ORDER: Final = FitOrder(SETTINGS.effort.brief_steps, SETTINGS.shooting.lengths[:1])
_ELIMINATIONS: Final[BatchFunction[_Eliminating, tuple[Expression, ...], Eliminated]] = BatchFunction(
    "eliminations", EliminationParts, Hashable, Eliminated, _eliminated, _built
)


def eliminate_all(
    comparison: ModelComparison, problem: Problem, libraries: Iterable[list[Expression]], until: float
) -> Iterator[FittedModel]:
    """Yield what `eliminated` gives of libraries, one after another as long as the estimator's work is below `until`.

    Where others take batches, all are gone through at the same time, and those that do not count are dropped.
    """
    if not comparison.spread.is_shared:
        for terms in libraries:
            if comparison.estimator.work < until:
                yield from eliminated(comparison, problem, terms)
        return
    tried = [tuple(terms) for terms in libraries]
    parts = partial(EliminationParts, comparison.parts, problem)
    for made in comparison.spread.map(_ELIMINATIONS, lambda: (comparison, problem), tried, parts=parts):
        if made is not None and comparison.estimator.work < until:
            comparison.estimator.count(made.work)
            for program, summary in zip(made.programs, made.summaries, strict=True):
                yield comparison.summarized(_ORDER, (program,), summary)


def eliminated(comparison: ModelComparison, problem: Problem, terms: list[Expression]) -> list[FittedModel]:
    """Return the fits on the way from the sum of all `terms` to a single one; `comparison` is for this state alone.

    Nothing where a term has no value somewhere.
    """
    models: list[FittedModel] = []
    while terms and not comparison.estimator.deadline.is_over:
        columns = np.array([values_of(sum_of([term], [1.0]), problem.inputs) for term in terms])
        if not np.isfinite(columns).all():
            break
        coefficients = _fitted(columns, problem.target.values)
        program = sum_of(terms, coefficients)
        model = comparison.fit_model([program], SETTINGS.effort.brief_steps, SETTINGS.shooting.lengths[:1])
        if model is not None:
            models.append(model)
        index = _least(model, columns, coefficients)
        terms = _moved([*terms[:index], *terms[index + 1 :]], model)
    return models


def _moved(terms: list[Expression], model: FittedModel | None) -> list[Expression]:
    """Return the terms with the constant of their denominators where the fit has left it, if that is positive."""
    if model is None:
        return terms
    program = model.programs[0]
    shifts = [float(program.constants[place]) for place in sorted(_below(program))]
    if len(shifts) != 1 or not 0.0 < shifts[0] < math.inf:
        return terms

    def moved(term: Expression) -> Expression:
        match term:
            case (code, above, (inner, variable, float())) if (code, inner) == (DIVIDE, ADD):
                return (DIVIDE, above, (ADD, variable, shifts[0]))
        return term

    return list(map(moved, terms))


def _below(program: Program) -> set[int]:
    """Return the nodes of the constants that denominators are made of."""
    nodes: set[int] = set()
    for index in range(len(program) - 1, -1, -1):
        code = int(program.operators[index])
        arguments = [int(program.left[index]), int(program.right[index])][: ARITY[code]]
        if index in nodes:
            nodes |= set(arguments)
        elif code == DIVIDE:
            nodes.add(arguments[1])
    return {index for index in nodes if program.operators[index] == CONSTANT}


def _fitted(columns: FloatArray, target: FloatArray) -> list[float]:
    """Return least-squares coefficients, a little off the numbers that would not stay."""
    beside = 1e-9 * np.abs(target).max() / np.maximum(np.abs(columns).max(axis=1), 1e-300)
    coefficients: list[float] = (coefficients_of(columns, target) + beside).tolist()
    return coefficients


def _least(model: FittedModel | None, columns: FloatArray, coefficients: Sequence[float]) -> int:
    """Return the index of the least significant term: by its fit, without one by its size."""
    by_size = int(np.argmin(np.abs(coefficients) * columns.std(axis=1)))
    if model is None:
        return by_size
    system = model.fit.system
    is_factor = ~np.isin(system.places, sorted(_below(model.programs[0])))
    if int(is_factor.sum()) != len(coefficients):
        return by_size
    variances = system.by_place(np.diag(covariance(model.fit)), 2)[:, is_factor]
    squares = system.by_place(system.values)[:, is_factor] ** 2
    return int(np.argmin(np.sqrt((squares / np.maximum(variances, 1e-300)).sum(axis=0))))
