"""Candidates for one equation of a process, by weighted regression on bins of steps. Pure.

A step is linear in the drift and the product of residuals in the diffusion, but for what the moments of a step add to
their leading terms; that is taken from the model so far:

    drift       (increment - (mean - h f)) / h              variance B_ii / h
    diffusion   (r_i r_j - (covariance_ij - h B_ij)) / h    variance in proportion to B_ii B_jj

so that, equation by equation, what is found by regression is what the likelihood asks for. Letters: V variables, N
steps, M bins.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Final

import numpy as np

from atoll_coordinator.data.increments import Steps, all_windows, lagged, products, split_into_bins
from atoll_coordinator.model.criteria import constant_nats_of, structure_length, system_length
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.regression.equation import FrontCandidate, Shortening
from atoll_coordinator.model.regression.fit import LeastSquares
from atoll_coordinator.model.sparse.elimination import eliminated
from atoll_coordinator.model.sparse.products import libraries, sum_of_products, values_of_products
from atoll_coordinator.model.stochastic.likelihood import ProcessModel
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import JobConfig
from atoll_core.data.dataset import FloatArray, Problem, Target
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.operators import ADD, BY_NAME, MULTIPLY
from atoll_core.expression.program import Program, constant_places, structure
from atoll_core.expression.restrictions import restrictions_of
from atoll_core.expression.unit_coefficients import make_coefficients_explicit
from atoll_core.expression.writing.shortest import shortest

_STEPS: Final = 3
"""Steps of a difference by which noise is told from drift."""


@dataclass(frozen=True, eq=False)
class WeightedProblem:
    """A regression problem over M bins, and the weights of these (M,), 1 on average."""

    problem: Problem
    weights: FloatArray


@dataclass(frozen=True, eq=False)
class CandidateFinder:
    """Finds candidates for the equations of one process.

    `steps` are all of them, `names` the symbols of variables and `variables` the names of equations; `config` says what
    equations may be made of. After the `deadline` nothing new is tried.
    """

    steps: Steps
    names: tuple[str, ...]
    variables: tuple[str, ...]
    config: JobConfig
    deadline: Deadline

    @cached_property
    def _rates(self) -> FloatArray:
        return mean_squares(self.steps)

    def find(
        self,
        number: int,
        model: ProcessModel,
        begun: Sequence[Program],
        *,
        looks_around: bool,
        by_differences: bool = False,
    ) -> list[Program]:
        """Return the most promising programs for one equation, factors of one as constants, the best first.

        Args:
            number: of the equation among those of `model`.
            model: the other equations, and what moments add to leading terms.
            begun: programs of the search.
            looks_around: whether programs beside the best ones are tried as well.
            by_differences: whether products of high differences stand for a component of the diffusion, whatever the
                drift is.
        """
        sides = (
            _sides_by_differences(number, model, self.steps) if by_differences else _sides(number, model, self.steps)
        )
        weighted, space = _problem(number, sides, model, self.steps, self._rates, self.names), self.config.space
        operators = frozenset(BY_NAME[name].code for name in space.operators_for(self.variables[number]))
        columns = space.columns_for(self.variables[number], self.names)
        sums = _sparse_sums(weighted, columns) if {ADD, MULTIPLY} <= operators else []
        restrictions = restrictions_of(self.config, self.variables[number], self.names)
        least_squares = LeastSquares(weighted.problem, weighted.weights, restrictions)
        shortening = Shortening(weighted.problem, operators, columns, least_squares, self.deadline)
        nats = constant_nats_of(len(self.steps.lengths))

        def length(candidate: FrontCandidate) -> float:
            """Return the description length as the likelihood would have it, but for the misfit."""
            program, misfit = candidate.fitted.program, shortening.criterion.misfit(candidate.fitted.mse)
            return system_length(misfit, [program], len(constant_places(program)), nats)

        candidates = sorted(shortening.candidates([*begun, *sums], looks_around), key=length)
        programs = [make_coefficients_explicit(shortest(candidate.fitted.program)).program for candidate in candidates]
        distinct = {structure(program): program for program in programs}
        is_variance = number >= len(model.drift) and len({*model.pairs[number - len(model.drift)]}) == 1
        possible = (program for program in distinct.values() if self._is_possible(program, is_variance=is_variance))
        return [*islice(possible, SETTINGS.effort.beam)]

    def _is_possible(self, program: Program, *, is_variance: bool) -> bool:
        """Tell whether a program is finite wherever steps begin, and not negative there if it is a variance."""
        values = values_of(program, self.steps.points)
        return bool(np.isfinite(values).all()) and not (is_variance and bool((values < 0.0).any()))


def _sides_by_differences(number: int, model: ProcessModel, steps: Steps) -> FloatArray:
    """Return what a component of the diffusion times the length of a step is to be (N,); NaN where a path ends."""
    windows = all_windows(steps, _STEPS)
    i, j = model.pairs[number - len(model.drift)]
    sides = np.full(len(steps.lengths), np.nan)
    sides[windows.first] = windows.differences(i) * windows.differences(j) * steps.lengths[windows.first]
    return sides


def _sides(number: int, model: ProcessModel, steps: Steps) -> FloatArray:
    """Return what one equation times the length of a step is to be (N,)."""
    states = len(model.drift)
    moments = model.moments(steps.points, steps.lengths)
    if number < states:
        leading = steps.lengths * values_of(model.drift[number], steps.points)
        added = moments.mean[number] - leading
        sides = steps.increments[number]
    else:
        i, j = model.pairs[number - states]
        leading = steps.lengths * values_of(model.diffusion[number - states], steps.points)
        added = moments.covariance[i, j] - leading
        sides = products(steps.increments - moments.mean, steps, (i, j), corrected=any(model.noise))
    return np.asarray(sides - added)


def _problem(
    number: int, sides: FloatArray, model: ProcessModel, steps: Steps, rates: FloatArray, names: tuple[str, ...]
) -> WeightedProblem:
    """Return the problem of one equation; steps begin where the one before them does if there is noise."""
    is_noisy = any(model.noise)
    states = len(model.drift)
    if number < states:
        variances = rates[number]
    else:
        i, j = model.pairs[number - states]
        variances = steps.lengths * rates[i] * rates[j]
    points, lengths = steps.points, steps.lengths
    if is_noisy:
        rows = np.flatnonzero(steps.follows)
        points, lengths, sides, variances = lagged(steps).points, lengths[rows], sides[rows], variances[rows]
    weights = lengths / variances
    is_used = np.isfinite(sides) & np.isfinite(weights) & (weights > 0.0)
    return _binned(points[:, is_used], sides[is_used] / lengths[is_used], weights[is_used], names)


def mean_squares(steps: Steps) -> FloatArray:
    """Return about how fast noise adds to the variance of each state at each step (S, N): means of squares in bins.

    The squares are those of high differences, so that the drift is not among them. Weights come from these rather than
    from the model so far, whose first one knows nothing of the states.
    """
    means = np.zeros_like(steps.increments)
    windows = all_windows(steps, _STEPS)
    squares = np.full_like(steps.increments, np.nan)
    for state in range(len(squares)):
        squares[state, windows.first] = windows.differences(state) ** 2
    for rows in split_into_bins(steps.points, 2 * math.isqrt(len(steps.lengths))):
        known = squares[:, rows][:, np.isfinite(squares[0, rows])]
        means[:, rows] = (known if known.size else squares[:, windows.first]).mean(axis=1)[:, None]
    return means


def _binned(points: FloatArray, sides: FloatArray, weights: FloatArray, names: tuple[str, ...]) -> WeightedProblem:
    bins = split_into_bins(points, SETTINGS.process.bins)
    total = np.array([weights[rows].sum() for rows in bins])
    means = np.array([(points[:, rows] * weights[rows]).sum(axis=1) for rows in bins]).T / total
    values = np.array([(sides[rows] * weights[rows]).sum() for rows in bins]) / total
    target = Target("", "", values, 0.0, float(values.std()) or 1.0, 1.0)
    return WeightedProblem(Problem(names, np.ascontiguousarray(means), target), total / total.mean())


def _sparse_sums(weighted: WeightedProblem, columns: Sequence[int]) -> list[Program]:
    """Return the best sums of products on the way from each library of them to nothing, by Schwarz's criterion."""
    inputs, roots = weighted.problem.inputs, np.sqrt(weighted.weights)
    sides = weighted.problem.target.values * roots
    rows = len(sides)
    sums: list[tuple[float, Program]] = []
    for terms, _ in libraries(columns, rows, range(1, SETTINGS.sparse.degree + 1)):
        values = values_of_products(terms, inputs) * roots
        path = eliminated(values, sides)
        prices = np.array([structure_length(sum_of_products([term], [1.5])) for term in terms]) + constant_nats_of(rows)
        for step in range(len(terms)):
            kept = path.kept(step)
            nats = 0.5 * rows * np.log(max(float(path.squares[step]), 1e-300)) + prices[kept].sum()
            program = sum_of_products([terms[place] for place in kept], path.factors(step))
            sums.append((float(nats), program))
    sums.sort(key=lambda entry: entry[0])
    return [program for _, program in sums[: SETTINGS.effort.beam // 2]]
