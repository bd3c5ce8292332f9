"""Proposers: functions that return candidate programs for an equation. They do not choose among these programs.

Each takes the modelling task, the name of a variable, and a limit of the length in nats (infinite if no limit is
known). Programs above this limit cannot be the model. Sources of proposals are the search, sparse regression, matching
pursuit of derivatives, pairs of terms, and candidates with one part removed. Doubt: most proposals are selected by
their error on smoothed derivatives, where the right program may have a low rank.
"""

import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from operator import itemgetter

import numpy as np

from atoll_coordinator.model.least_squares import coefficients_of
from atoll_coordinator.model.regression.fit import LeastSquares
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.selection.task import ModellingTask
from atoll_coordinator.model.sparse.atoms import polynomial_and_fourier_libraries, sum_of
from atoll_coordinator.model.sparse.pursuit import PURSUED, Pursuit
from atoll_coordinator.model.structure.moves.reductions import reductions
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import Problem
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.operators import CONSTANT, POW
from atoll_core.expression.program import Program, structure, with_constants
from atoll_core.expression.writing.shortest import shortened


def propose_nearest(task: ModellingTask, name: str, most: float) -> Iterable[Program]:
    """Return the best programs of the search, and the laws found by sparse regression."""
    del most
    settled = [task.settled[name].program] if name in task.settled else []
    laws = (law.program for law in task.laws.get(name, ()))
    return [*settled, *task.candidates[name].nearest, *laws]


def propose_sums(task: ModellingTask, name: str, most: float) -> Iterable[Program]:
    """Return sums of a polynomial and of functions, see `pursue`."""
    return _pursue_by_group(task, name, most)


def propose_reduced(
    model: FittedModel, comparison: ModelComparison, task: ModellingTask, equation: int, candidates: Sequence[Program]
) -> list[Program]:
    """Return candidates above the length limit with one part removed, sorted by their error on the derivatives."""
    most, own = comparison.score.length_limit(model, equation), model.programs[equation]
    long = [program for program in candidates if comparison.score.length(program) >= most][: SETTINGS.effort.beam]
    known = {structure(own), *map(structure, candidates)}
    smaller = (shortened(reduced) for program in long if not task.is_over for reduced in reductions(program))
    tried = {
        structure(program): program
        for program in smaller
        if structure(program) not in known and comparison.score.length(program) < most and task.may_be_shown(program)
    }
    squares = LeastSquares(
        task.dataset.problem(task.variables[equation]), restrictions=comparison.restrictions(equation)
    )
    fits = (squares.fit(program) for program in tried.values() if not task.is_over)
    fitted = sorted(fits, key=lambda one: one.mse)
    kept = [one.program for one in fitted if math.isfinite(one.mse)][: SETTINGS.effort.beam]
    whole = (whole for program in kept for whole in _with_whole_powers(program))
    return [*kept, *filter(task.may_be_shown, whole)] or [own]


def _with_whole_powers(program: Program) -> Iterator[Program]:
    """Yield copies of the program in which one constant exponent is rounded to a whole number, and a copy in which all
    constant exponents are rounded."""
    nodes = program.nodes()
    exponents = {right: nodes[right][3] for code, _, right, _ in nodes if code == POW and nodes[right][0] == CONSTANT}
    whole = {place: float(round(value)) for place, value in exponents.items() if math.isfinite(value) and round(value)}
    choices = [{place: value} for place, value in whole.items()]
    for choice in [*choices, whole] if len(choices) > 1 else choices:
        yield shortened(with_constants(program, choice))


def with_target_values_of(program: Program, problem: Problem, uncertainty: float) -> Problem | None:
    """Return the problem with the values of a program as target. `uncertainty` is a share of the standard deviation of
    these values.

    None if the values are constant or not finite.
    """
    values = values_of(program, problem.inputs)
    deviation = float(values.std())
    if not 0.0 < deviation < math.inf:
        return None
    target = replace(problem.target, values=values, uncertainty=uncertainty, standard_deviation=deviation)
    return replace(problem, target=target)


def propose_all(task: ModellingTask, name: str, most: float) -> Iterable[Program]:
    """Return all programs passed from the search to refining."""
    del most
    return task.candidates[name].programs


def propose_pairs(task: ModellingTask, name: str) -> list[Program]:
    """Return the sums of two products up to the second degree, sorted by their residuals on the derivatives.

    In logistic growth, for example, each of the two terms alone fits worse than a constant. So the sum of both terms is
    not found by adding or changing one term at a time.
    """
    problem = task.dataset.problem(name)
    terms = next(polynomial_and_fourier_libraries(task.columns(name), task.operators(name)), [])
    columns = np.array([values_of(sum_of([term], [1.0]), problem.inputs) for term in terms])
    fitted = list[tuple[float, Program]]()
    for first, second in combinations(range(len(terms)), 2):
        both = columns[[first, second]]
        if np.isfinite(both).all():
            factors = coefficients_of(both, problem.target.values)
            left = problem.target.values - factors @ both
            program = sum_of([terms[first], terms[second]], factors.tolist())
            fitted.append((float(left @ left), program))
    return [program for _, program in sorted(fitted, key=itemgetter(0)) if task.may_be_shown(program)]


def propose_further_sums(task: ModellingTask, name: str, most: float) -> Iterable[Program]:
    """Return sums with the further operators, which a search does not use at first."""
    return (
        _pursue_by_group(task, name, most, task.further_operators(name))
        if may_use_further_operators(task, name)
        else ()
    )


def may_use_further_operators(task: ModellingTask, name: str) -> bool:
    """Tell whether further operators may be tried for an equation.

    False for a known equation. Also False for a law that was found among many variables from derivatives: such an
    equation has no other candidates."""
    return bool(task.further_operators(name)) and name not in task.rate_law_variables and name not in task.known


def _pursue_by_group(task: ModellingTask, name: str, most: float, needed: Collection[int] = ()) -> list[Program]:
    problem = task.dataset.problem(name)
    parts = [problem.of_group(group) for group in range(len(task.recording.groups))] or [problem]
    operators = task.operators(name) | set(needed)
    search_space = Pursuit(task.columns(name), frozenset(operators), frozenset(needed), most)
    return [program for part in parts for program in _pursue(task, part, search_space)]


def _pursue(task: ModellingTask, problem: Problem, search_space: Pursuit) -> tuple[Program, ...]:
    """Return the sums with the smallest residuals on a target; empty if the time is over."""
    return task.spread.map(PURSUED, lambda: problem, [search_space])[0] or ()
