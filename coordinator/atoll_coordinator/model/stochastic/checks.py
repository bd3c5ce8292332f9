"""The checks of the equations of a process, from the whitened steps: quantities, limits, clauses. Pure.

For the right law the whitened steps of every state are independent and normal, with variance one. `ProcessChecks` tests
these properties by correlations of neighbouring steps (Ljung & Box 1978), means and squares in bins of the states
(chi-square), the fourth moment, and products with the steps of other states. For a state without noise of its own, the
size of the steps is also tested.

Doubtful: bins are wide, so fine structure of a drift is not tested. The checks of a variance assume normal noise: for a
process with jumps they fail, even if the drift is right.

Letters: S states, N steps.
"""

import math
from collections.abc import Sequence
from functools import cached_property
from typing import ClassVar, Final

import numpy as np

from atoll_coordinator.data.increments import Rows, split_into_bins
from atoll_coordinator.model.inference.checks import EquationChecks, Finding
from atoll_coordinator.model.inference.residuals import residual_statistics
from atoll_coordinator.model.refinement import JobKind, Refined
from atoll_coordinator.model.regression.fit import contains
from atoll_coordinator.model.stochastic.likelihood import ProcessModel
from atoll_coordinator.model.stochastic.process_choice import ChosenProcess, is_zero
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray, Target

_UNTESTED: Final = Finding("not applicable", "this check does not apply to this equation")


class ProcessSteps:
    """The whitened `residuals` (S, N) of the steps of a `model`, for tests of the model.

    `has_noise`: whether at least one state has noise that counts; otherwise the process is deterministic. Some tables
    follow a law exactly, such as the output of a numerical method, or a table that repeats after a few rows. Then no
    noise is left for tests. `noiseless_states` are the states without noise of their own. The steps of the states
    `exact_states` follow their equation up to rounding.
    """

    def __init__(self, chosen: ChosenProcess, model: ProcessModel) -> None:
        self.chosen, self.model = chosen, model
        self.states: Final = chosen.process.states
        steps = chosen.likelihood.steps
        self.residuals: Final = chosen.likelihood.whiten(model).residuals
        variances = np.median(np.diagonal(model.moments(steps.points, steps.lengths).covariance), axis=0)
        self.has_noise: Final = any(model.noise) or not bool((variances <= steps.least_variances).all())
        components = zip(model.pairs, model.diffusion, strict=True)
        self.noiseless_states: Final = [i for (i, j), program in components if i == j and is_zero(program)]
        is_stepped = model.discretisation == "Euler-Maruyama"
        self.exact_states: Final = [
            state for state in self.noiseless_states if is_stepped and float(np.mean(self.residuals[state] ** 2)) < 1.0
        ]

    @cached_property
    def bins(self) -> Sequence[Rows]:
        """Bins of steps that start in neighbouring states."""
        return split_into_bins(self.chosen.likelihood.steps.points, SETTINGS.effort.kept)

    def pattern_probability(self, values: FloatArray) -> float:
        """Return the p-value of the means of `values` (N,) in bins, for the hypothesis that all expected values are
        zero."""
        from scipy import special

        variance = float(np.var(values))
        if not variance > 0.0:
            return 1.0  # all values are equal, like residuals of exact steps: this is no pattern, for any mean
        squares = [len(rows) * float(np.mean(values[rows])) ** 2 / variance for rows in self.bins if len(rows)]
        return float(special.chdtrc(len(squares), math.fsum(squares)))

    def serial_probability(self, state: int) -> float:
        """Return the p-value of the correlation of neighbouring steps of this state, for the hypothesis that steps are
        independent."""
        follows = self.chosen.likelihood.steps.follows
        pieces = np.split(self.residuals[state], np.flatnonzero(~follows)[1:])
        pattern_probability = residual_statistics(pieces, 1.0).pattern_probability
        return 2.0 * min(pattern_probability, 1.0 - pattern_probability)


class ProcessChecks(EquationChecks):
    """The checks of one equation of a process: the drift of a state, or a component of the diffusion."""

    kind: ClassVar[JobKind] = "process"
    default_finding: ClassVar[Finding] = _UNTESTED

    def __init__(self, shown: Refined, target: Target, steps: ProcessSteps, number: int) -> None:
        """Set the equation that is shown, its `number` among the equations of the process, and the steps."""
        super().__init__(shown, target, stopped="the choice of the equations" if steps.chosen.is_stopped else "")
        self._steps = steps
        states = len(steps.states)
        self._drift: int | None = number if number < states else None
        self._pair = (number, number) if number < states else steps.model.pairs[number - states]
        self._is_zero = number >= states and is_zero(shown.program)
        i, j = self._pair
        if self._is_zero and i == j:
            self._drift = i  # without noise of its own, the steps of the state test the drift as well as the variance
        if self._drift in steps.exact_states or not steps.has_noise:
            self._drift = None
        is_component = number >= states and not self._is_zero
        self._is_untested = self._drift is None and not (is_component and steps.has_noise)

    @property
    def merit(self) -> str:
        """The reason why the equation is good."""
        i, j = self._pair
        if self._is_zero:
            whose = "this state has no noise of its own: the noise of other states explains its steps"
            return whose if i == j else "the noises of these states are not correlated beyond chance"
        if self._is_untested:
            return "the steps follow this equation up to rounding"
        merit = "the residual steps are independent and without a pattern over the states"
        return merit if self._drift is not None else f"{merit}, and they are normally distributed"

    def check_noise(self) -> Finding:
        """Check that there is noise to test the equations."""
        if self._steps.has_noise:
            return Finding("passed", "the steps have noise")
        reason = "no state shows noise, so that the process is not stochastic"
        return Finding("failed", reason, advice="leave out --stochastic; the equations of motion are then judged")

    def check_pattern_of_steps(self) -> Finding:
        """Check that the steps of the state have mean zero in all bins of the states."""
        if self._drift is None:
            return _UNTESTED
        probability = self._steps.pattern_probability(self._steps.residuals[self._drift])
        fault = f"the residual steps follow a pattern over the states (p = {probability:.1g})"
        return _judge_probability(probability, fault, "the steps show no pattern over the states")

    def check_serial_correlation(self) -> Finding:
        """Check that the steps of the state are independent of the steps before them."""
        if self._drift is None:
            return _UNTESTED
        probability = self._steps.serial_probability(self._drift)
        fault = f"steps are correlated with the steps before them (p = {probability:.1g})"
        return _judge_probability(probability, fault, "steps are independent of the steps before them")

    def check_size_of_steps(self) -> Finding:
        """Check that whitened steps of a state without noise of its own have variance one."""
        if self._drift is None or self._drift not in self._steps.noiseless_states:
            return _UNTESTED
        squares = self._steps.residuals[self._drift] ** 2
        probability, size = mean_probability(squares - 1.0), math.sqrt(float(np.mean(squares)))
        fault = (
            f"its steps are {size:.3g} times as large as the noise of the other states predicts (p = {probability:.1g})"
        )
        return _judge_probability(
            probability, fault, "its steps are as large as the noise of the other states predicts"
        )

    def check_correlation_of_states(self) -> Finding:
        """Check that the steps of the state are independent of the steps of other states."""
        residuals, names = self._steps.residuals, self._steps.states
        others = [other for other in range(len(names)) if other != self._drift]
        if self._drift is None or not others:
            return _UNTESTED
        own = residuals[self._drift]
        probability, other = min((mean_probability(own * residuals[other]), other) for other in others)
        fault = f"the residual steps are correlated with the steps of {names[other]} (p = {probability:.1g})"
        return _judge_probability(
            probability, fault, "its steps are independent of the steps of other states", len(others)
        )

    def check_pattern_of_squared_steps(self) -> Finding:
        """Check that the product of the steps of both states (for a variance, the square) has the expected mean in all
        bins of the states."""
        if self._drift is not None or self._is_untested:
            return _UNTESTED
        i, j = self._pair
        products = self._steps.residuals[i] * self._steps.residuals[j] - (1.0 if i == j else 0.0)
        probability = self._steps.pattern_probability(products)
        fault = f"the squares of the residual steps follow a pattern over the states (p = {probability:.1g})"
        return _judge_probability(probability, fault, "the squares of the steps show no pattern over the states")

    def check_normal_steps(self) -> Finding:
        """Check the fourth moment of the steps of the state."""
        from scipy import special

        i, j = self._pair
        if self._drift is not None or self._is_untested or i != j:
            return _UNTESTED
        kurtosis = float(np.mean(self._steps.residuals[i] ** 4)) - 3.0
        probability = float(special.ndtr(-kurtosis / math.sqrt(24.0 / self._steps.residuals.shape[1])))
        fault = f"the steps have heavier tails than a normal distribution (excess kurtosis {kurtosis:.2g})"
        return _judge_probability(probability, fault, "the steps are normally distributed")

    def check_constants(self) -> Finding | None:
        """Check that the data determine all constants. If there is only one constant, it may be zero, so the check does
        not apply."""
        if self._is_untested or len(self.shown.constants) < 2:
            return Finding("not applicable", "it has one constant at most")
        return super().check_constants()

    def check_alternative_equations(self) -> Finding | None:
        """Check that no alternative describes the steps about as well. An alternative that contains this equation is
        ignored."""
        if self._is_untested or self._is_zero:
            return _UNTESTED
        limit, points = SETTINGS.inference.distinct_nats, self._steps.chosen.likelihood.steps.points
        others = [other for other in self.shown.alternatives if not other.is_shown and other.nats < limit]
        near = (other.nats for other in others if not contains(other.program, self.shown.program, points))
        nats = next(near, None)
        if nats is None:
            return Finding("passed", "no other equation describes the data about as well")
        reason = f"another equation describes the data about as well (Δ description length {nats:.1f})"
        return Finding("failed", reason, nats, limit)


def _judge_probability(probability: float, fault: str, merit: str, tests: int = 1) -> Finding:
    """Return the finding of a check from `probability`, the smallest p-value of several `tests` (Bonferroni)."""
    limit = SETTINGS.inference.improbable / tests
    return (
        Finding("failed", fault, probability, limit)
        if probability < limit
        else Finding("passed", merit, probability, limit)
    )


def mean_probability(values: FloatArray) -> float:
    """Return the p-value of the mean of `values` (N,), for the hypothesis that their expected value is zero."""
    from scipy import special

    error = float(values.std()) / math.sqrt(len(values))
    return 2.0 * float(special.ndtr(-abs(float(values.mean())) / error)) if error > 0.0 else 1.0
