"""Candidates for one equation of a process, found by weighted regression on bins of steps. Pure if there is no
deadline.

`CandidateFinder.find` decides which candidates are fitted by the likelihood later. The mean of a step is linear in the
drift f. The mean product of two residuals r is linear in the diffusion B. Both also have terms of higher order in the
length h of the step. These terms are computed from the present model and subtracted:

    drift       (increment - (mean - h f)) / h              variance B_ii / h
    diffusion   (r_i r_j - (covariance_ij - h B_ij)) / h    variance in proportion to B_ii B_jj

With these variances, the regression maximises the likelihood of one equation. `CandidateFinder.find` shortens sums of
products and programs of the search (`regression.shortening`), and returns the shortest descriptions.

Doubtful: bins average over the states, so candidates with fine structure are fitted poorly. The weights use noise
rates, which are estimated from differences of high order.

Letters: S states, V variables, N steps, M bins.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Final

import numpy as np

from atoll_coordinator.data.increments import Steps, all_windows, lagged, products, split_into_bins
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.description_length import RegressionCriterion, constant_nats_of, system_length
from atoll_coordinator.model.regression.equation import make_target_shortening
from atoll_coordinator.model.regression.fit import LeastSquares
from atoll_coordinator.model.regression.shortening import MeasuredProgram
from atoll_coordinator.model.sparse.atoms import polynomial_libraries, product_atoms
from atoll_coordinator.model.sparse.regression import SparseRegression, Sum
from atoll_coordinator.model.sparse.rows import RegressionRows
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
"""Order of the differences that remove the drift."""


@dataclass(frozen=True, eq=False)
class CandidateFinder:
    """Finds candidates for the equations of one process.

    `names` are the symbols of variables, and `variables` are the names of equations. `config` lists the allowed
    operators and variables. After the `deadline` no new program is tried.
    """

    steps: Steps
    names: tuple[str, ...]
    variables: tuple[str, ...]
    config: JobConfig
    deadline: Deadline

    @cached_property
    def _noise_rates(self) -> FloatArray:
        return estimate_noise_rates(self.steps)

    def find(
        self,
        number: int,
        model: ProcessModel,
        starts: Sequence[Program],
        *,
        tries_neighbours: bool,
    ) -> list[Program]:
        """Return the best programs for one equation, the best first. Factors of one are written as constants.

        Args:
            number: number of the equation in `model`.
            model: the present model; its equations are used to compute the higher terms of moments.
            starts: programs of the search, or of the previous round.
            tries_neighbours: whether neighbours of the best programs are tried as well.
        """
        problem, weights = _make_problem(number, model, self.steps, self._noise_rates, self.names)
        space = self.config.space
        operators = frozenset(BY_NAME[name].code for name in space.operators_for(self.variables[number]))
        columns = space.columns_for(self.variables[number], self.names)
        sums = _fit_sparse_sums(problem, weights, columns) if {ADD, MULTIPLY} <= operators else []
        restrictions = restrictions_of(self.config, self.variables[number], self.names)
        least_squares = LeastSquares(problem, weights, restrictions)
        criterion, nats = RegressionCriterion.of(problem.target), constant_nats_of(len(self.steps.lengths))
        shortening = make_target_shortening(least_squares, criterion, operators, columns, self.deadline)

        def length(measured: MeasuredProgram) -> float:
            """Return the description length of a candidate. Its operators and constants have the same prices as in the
            comparison by the likelihood of steps."""
            return system_length(measured.misfit, [measured.program], len(constant_places(measured.program)), nats)

        found = [
            measured for measured, _ in shortening.find_candidates([*map(shortest, starts), *sums], tries_neighbours)
        ]
        programs = [
            make_coefficients_explicit(shortest(measured.program)).program for measured in sorted(found, key=length)
        ]
        distinct = {structure(program): program for program in programs}
        is_variance = number >= len(model.drift) and len({*model.pairs[number - len(model.drift)]}) == 1
        possible = (program for program in distinct.values() if self._is_possible(program, is_variance=is_variance))
        return [*islice(possible, 2 * SETTINGS.effort.beam // 3)]

    def _is_possible(self, program: Program, *, is_variance: bool) -> bool:
        """Tell whether a program is finite at the start of all steps. A variance must also be zero or positive
        there."""
        values = values_of(program, self.steps.points)
        return bool(np.isfinite(values).all()) and not (is_variance and bool((values < 0.0).any()))


def _make_problem(
    number: int, model: ProcessModel, steps: Steps, rates: FloatArray, names: tuple[str, ...]
) -> tuple[Problem, FloatArray]:
    """Return the regression problem of one equation over bins, and the weights of the bins.

    `rates` (S, N) are the noise rates. If there is measurement noise, each step is paired with the state one row before
    the step, so that the errors of the variables are independent of the errors of the step.
    """
    states, lengths, points = len(model.drift), steps.lengths, steps.points
    moments = model.moments(points, lengths)
    leading = lengths * values_of(model.programs[number], points)
    if number < states:
        sides, variances = steps.increments[number] - (moments.mean[number] - leading), rates[number]
    else:
        i, j = model.pairs[number - states]
        sides = products(steps.increments - moments.mean, steps, (i, j), corrected=any(model.noise))
        sides, variances = sides - (moments.covariance[i, j] - leading), lengths * rates[i] * rates[j]
    if any(model.noise):
        rows = np.flatnonzero(steps.follows)
        points, lengths, sides, variances = lagged(steps).points, lengths[rows], sides[rows], variances[rows]
    weights = lengths / variances
    is_used = np.isfinite(sides) & np.isfinite(weights) & (weights > 0.0)
    return _bin_steps(points[:, is_used], sides[is_used] / lengths[is_used], weights[is_used], names)


def estimate_noise_rates(steps: Steps) -> FloatArray:
    """Return the estimated noise rate (S, N) of each state at each step: how fast noise increases the variance of the
    state. The rates are mean squares of differences of high order in bins; such differences remove the drift.

    The weights follow from these rates and not from the present model, since the noise of the first model is constant.
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


def _bin_steps(
    points: FloatArray, sides: FloatArray, weights: FloatArray, names: tuple[str, ...]
) -> tuple[Problem, FloatArray]:
    bins = split_into_bins(points, SETTINGS.rows.most // 4)
    total = np.array([weights[rows].sum() for rows in bins])
    means = np.array([(points[:, rows] * weights[rows]).sum(axis=1) for rows in bins]).T / total
    values = np.array([(sides[rows] * weights[rows]).sum() for rows in bins]) / total
    target = Target("", "", values, 0.0, float(values.std()) or 1.0, 1.0)
    return Problem(names, np.ascontiguousarray(means), target), total / total.mean()


def _fit_sparse_sums(problem: Problem, weights: FloatArray, columns: Sequence[int]) -> list[Program]:
    """Return the best sums of products by Schwarz's criterion. They are found by removing terms from each library, one
    at a time."""
    rows, roots = RegressionRows(problem.inputs, problem.target.values), np.sqrt(weights)
    sums: list[Sum] = []
    for terms, _ in polynomial_libraries(columns, len(roots), range(1, SETTINGS.sparse.degree + 1)):
        regression = SparseRegression(rows, product_atoms(rows.inputs, terms))
        sums += regression.elimination_path(range(len(terms)), roots)
    sums.sort(key=lambda fit: fit.nats)
    return [fit.sum_of_products() for fit in sums[: SETTINGS.effort.beam // 2]]
