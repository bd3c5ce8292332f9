"""The modelling task: measurements and candidates (`ModellingTask`); and the chosen system (`SelectedModel`)."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

from atoll_coordinator.data.recording import FoundMinima, Recording
from atoll_coordinator.data.templates import template_of
from atoll_coordinator.model.batches import Spread
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.pools import Law, LawsByGroup, may_be_shown
from atoll_coordinator.model.refinement import Refined
from atoll_coordinator.model.selection.candidates import CandidateSet
from atoll_coordinator.model.selection.comparison import Constraints, ModelComparison
from atoll_coordinator.model.selection.grouped_rows import GroupedRows
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.shooting.measurements import TrajectoryMeasurements, measurements_of
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.model.shooting.system import variable_program
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset, FloatArray
from atoll_core.expression.operators import BY_NAME
from atoll_core.expression.program import Program
from atoll_core.expression.restrictions import Restrictions, restrictions_of
from atoll_core.expression.template import EquationTemplate
from atoll_core.expression.writing.shortest import shortest

_TOLERATED_NOISE: Final = 0.01
"""Largest error of an integration step as a share of the noise."""


@dataclass(frozen=True, eq=False)
class ModellingTask:
    """The measurements, and the variables that have `candidates`, in the order of the equations.

    `settled` are equations that were already fitted to noise-free targets. `spread` computes work in threads or on
    workers. `piece` is the largest number of rows that are simulated without a break. After the `deadline` nothing new
    is tried. `solver` names the solver whose errors were subtracted from the recording. `among_many` are laws that were
    found during preparation (None: not searched). With the values `parameters` of the parameters of a template, fits
    start (None: with the template's start values). `minima` tells what fits from many starts found, None: there were
    none.
    """

    dataset: Dataset
    recording: Recording
    config: JobConfig
    candidates: Mapping[str, CandidateSet]
    settled: Mapping[str, Refined] = field(default_factory=dict)
    spread: Spread = field(default_factory=Spread)
    piece: int = SETTINGS.shooting.piece
    laws: Mapping[str, Sequence[Law]] = field(default_factory=dict)
    deadline: Deadline | None = None
    solver: str | None = None
    among_many: LawsByGroup | None = None
    parameters: FloatArray | None = None
    minima: FoundMinima | None = None
    _restrictions: dict[str, Restrictions] = field(default_factory=dict, repr=False)

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of the equations."""
        return tuple(self.candidates)

    @cached_property
    def known(self) -> dict[str, Program]:
        """The equations given by the user, and the sides of a template in which nothing is searched."""
        return {
            name: equation_candidates.known
            for name, equation_candidates in self.candidates.items()
            if equation_candidates.known is not None
        }

    @cached_property
    def template(self) -> EquationTemplate:
        """The given equations with parameters and unknown parts."""
        return template_of(self.config, self.dataset.names)

    @property
    def parameter_values(self) -> FloatArray:
        """The values of the parameters of the template with which fits start."""
        return self.template.starts if self.parameters is None else self.parameters

    @cached_property
    def rate_law_variables(self) -> frozenset[str]:
        """The variables with a law from the search among many variables (`Law.is_of_rates`): the law was fitted to
        derivatives, and its terms were chosen from all terms."""
        return frozenset(name for name, laws in self.laws.items() if laws and laws[0].is_of_rates)

    @property
    def is_over(self) -> bool:
        """Whether the time is over, so that nothing new may start."""
        return self.deadline is not None and self.deadline.is_over

    @property
    def has_been_stopped(self) -> bool:
        """Whether the time limit has stopped any work."""
        return self.deadline is not None and self.deadline.has_cut_short

    @property
    def is_limited(self) -> bool:
        """Whether the time limit may end the choice early."""
        return self.deadline is not None and self.deadline.seconds is not None

    @property
    def is_nearly_clean(self) -> bool:
        """Whether the independent errors of all states are too small to hide a term of a law."""
        return all(smoothing.relative_noise < SETTINGS.selection.least_noise for smoothing in self.recording.smoothing)

    def may_be_shown(self, program: Program) -> bool:
        """Tell whether `program` can be printed and meets the job's size limit."""
        return may_be_shown(program, self.config.space.max_size)

    def operators(self, variable: str) -> frozenset[int]:
        """Return the codes of the operators that the equation of `variable` may contain."""
        return frozenset(BY_NAME[name].code for name in self.config.space.operators_for(variable))

    def further_operators(self, variable: str) -> frozenset[int]:
        """Return the codes of the operators that a search does not use at first, and that refining may try."""
        return frozenset(BY_NAME[name].code for name in self.config.space.further_operators_for(variable))

    def columns(self, variable: str) -> tuple[int, ...]:
        """Return the indices of the variables that the equation of `variable` may use."""
        return self.config.space.columns_for(variable, self.dataset.names)

    def converged_equation(self, name: str) -> Program | None:
        """Return the known equation, or the equation to which the search of a noise-free target has converged; else
        None."""
        if name in self.known:
            return self.known[name]
        target = self.dataset.problem(name).target
        if name in self.settled and not target.is_noisy and not self.recording.groups:
            refined = self.settled[name]
            if refined.error <= target.convergence_error(self.config.budget.target_error):
                return shortest(refined.program)
        return None

    def measurements(self, variables: Sequence[str], *, held_out: bool = False) -> TrajectoryMeasurements:
        """Return the measurements of a system for these variables."""
        states = [self.recording.states.index(name) for name in variables]
        columns = [self.recording.states.index(name) for name in self.columns_observed_with(variables)]
        return measurements_of(self.recording, states, held_out=held_out, piece=self.piece, observed=columns)

    def columns_observed_with(self, variables: Sequence[str]) -> tuple[str, ...]:
        """Return the measured columns that are computed from the states of a system for these variables: all such
        columns if the system is whole, else none."""
        return self.recording.observed if len(variables) == len(self.variables) else ()

    @property
    def shown_names(self) -> tuple[str, ...]:
        """Names of the measured columns of the whole system, and then of its hidden states."""
        hidden = self.recording.hidden
        return (*(name for name in self.variables if name not in hidden), *self.recording.observed, *hidden)

    def in_pieces(self, rows: int) -> "ModellingTask":
        """Return the task with pieces of at most this many rows.

        With hidden states, the task keeps its pieces: in the middle of a trajectory, the values of hidden states are
        unknown, and with a number of its own for each piece almost any law would fit.
        """
        return self if self.recording.hidden else replace(self, piece=min(self.piece, rows))

    @property
    def longest(self) -> int:
        """The number of rows of the longest trajectory that is not held out."""
        return max(len(part.times) for part in self.recording.trajectories if not part.held_out)

    @cached_property
    def compared_measurements(self) -> TrajectoryMeasurements:
        """The measurements of all variables, thinned to the rows on which systems with this many states are
        compared."""
        settings = SETTINGS.selection
        rows = min(settings.compared_rows, settings.compared_numbers // max(len(self.variables), 1))
        return self.measurements(self.variables).thin(rows)

    @cached_property
    def sizes(self) -> list[float]:
        """The mean absolute value of each variable of the dataset."""
        measurements = self.compared_measurements
        sizes = dict(zip(measurements.variables, measurements.sizes.tolist(), strict=True))
        return [sizes[name] for name in self.dataset.names]

    def sizes_for(self, variable: str) -> list[float]:
        """Return the mean absolute value of each variable of the dataset; 0 for variables that the equation of
        `variable` may not use."""
        columns = self.columns(variable)
        return [size if column in columns else 0.0 for column, size in enumerate(self.sizes)]

    @cached_property
    def comparison(self) -> ModelComparison:
        """The comparison over `compared_measurements`. It is shared by all stages with this piece length, so that
        nothing is fitted twice."""
        return self.make_comparison(self.compared_measurements, self.variables)

    def with_comparison(self, comparison: ModelComparison) -> "ModellingTask":
        """Return the task with this `comparison`, whose errors were calibrated (`ModelComparison.calibrate`)."""
        task = replace(self)
        task.__dict__["comparison"] = comparison  # the value of the cached property
        return task

    def make_comparison(
        self, measurements: TrajectoryMeasurements, variables: Sequence[str], *, is_precise: bool = False,
        has_noise: bool = True, measured_rows: int = 0,
    ) -> ModelComparison:  # fmt: skip
        """Return a comparison over these measurements. They may represent a larger number of rows of the same time
        span, `measured_rows`.

        The tolerated error of an integration step is a share of the noise; without `has_noise` the noise counts as
        zero. The errors of all steps may have the same sign, while noise is averaged over the rows. So if the
        comparison `is_precise`, the limit is lower: the sum of the integration errors along a piece is at most the
        share `_TOLERATED_NOISE` of the standard error of a mean over the rows. In such a comparison, interpolation
        errors do not count as noise.
        """
        noise = float(measurements.relative_noise.min()) if has_noise else 0.0
        if is_precise and not any(self.dataset.problem(name).target.is_noisy for name in self.candidates):
            noise = 0.0
        error = _TOLERATED_NOISE * max(noise, SETTINGS.shooting.exact)
        if is_precise:
            longest = int((measurements.bounds[:, 1] - measurements.bounds[:, 0]).max())
            error /= longest * max(1.0, measured_rows / measurements.rows) * math.sqrt(measurements.rows)
        tolerance = max(error, _TOLERATED_NOISE * SETTINGS.shooting.exact)
        fixed = [index for index, name in enumerate(variables) if name in self.known]
        sides = (*variables, *self.columns_observed_with(variables))
        template = self.template.for_equations(sides)
        restrictions = {index: self.restrictions(name) for index, name in enumerate(variables)}
        restrictions = {index: restriction for index, restriction in restrictions.items() if not restriction.are_none}
        return ModelComparison(
            MultipleShooting(measurements, tolerance, self.deadline, measured_rows, self.spread), self.dataset.names,
            frozenset(fixed), tuple(self.leading(variables)), self.spread,
            Constraints(restrictions, self.grouped_rows(variables), template, self.parameter_values),
        )  # fmt: skip

    def restrictions(self, variable: str) -> Restrictions:
        """Return the restrictions of the equation of `variable`."""
        if variable not in self._restrictions:
            self._restrictions[variable] = restrictions_of(
                self.config, variable, self.dataset.names, self.dataset.inputs
            )
        return self._restrictions[variable]

    def grouped_rows(self, variables: Sequence[str]) -> GroupedRows | None:
        """Return the rows by group, where groups of trajectories have constants of their own."""
        count = len(self.recording.groups)
        if not count:
            return None
        problems = [
            [] if name in self.known else [self.dataset.problem(name).of_group(group) for group in range(count)]
            for name in variables
        ]
        return GroupedRows(count, problems, {index: self.restrictions(name) for index, name in enumerate(variables)})

    def leading(self, variables: Sequence[str]) -> list[Program]:
        """Return the equations of the positions, whose derivatives are the velocities; empty for order 1."""
        if self.recording.order == 1:
            return []
        velocities = [self.recording.velocity_symbols[self.recording.states.index(name)] for name in variables]
        return [variable_program(self.dataset.names.index(velocity)) for velocity in velocities]


@dataclass(frozen=True, eq=False)
class SelectedModel:
    """The system that describes the trajectories in the fewest nats: its fit, and the comparison that found it.

    `lists` are the candidates of each variable before the search. `widened` are the variables for whose equations
    further operators were tried.
    """

    task: ModellingTask
    comparison: ModelComparison
    model: FittedModel
    lists: Sequence[Sequence[Program]] = ()
    widened: Sequence[str] = ()

    @property
    def is_like_noise(self) -> bool:
        """Whether the residuals of every state are about as large as its noise."""
        return self.comparison.score.excess(self.model) <= SETTINGS.inference.excess
