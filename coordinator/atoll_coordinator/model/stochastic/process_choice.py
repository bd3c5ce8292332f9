"""Chooses the equations that together are the law of a process: the law with the shortest description.

The description length is the same as for systems along trajectories (`description_length.system_length`): minus the
log-likelihood of all steps, the prices of the programs, and half the logarithm of the number of steps for each
constant. `ProcessChoice.choose` starts with Brownian motion and exchanges one equation at a time. Candidates come from
a regression that uses the present model (`candidate_regression`). They are fitted by the likelihood, while the other
equations stay fixed. Then all equations are fitted together. This is repeated until no equation is exchanged. A
covariance of two noises may become zero. A variance may become zero as well: the state then has no noise of its own,
and its equation is an ordinary differential equation.

Many tables were computed by the Euler-Maruyama method. So at the end, the equations are also fitted under the
assumption that the rows are steps of this method. This discretisation is chosen if its description is shorter by a
clear margin.

Doubtful: exchanging one equation at a time can end in a local optimum, especially for drift and diffusion of the same
state. The first candidates depend on the initial model, which fits badly.
"""

import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from atoll_coordinator.data.increments import Steps, take_steps
from atoll_coordinator.data.recording import ProcessRecording
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.description_length import constant_nats_of, system_length
from atoll_coordinator.model.regression.shortening import MARGIN, MeasuredProgram, Shortening
from atoll_coordinator.model.selection.candidates import CandidateSet
from atoll_coordinator.model.stochastic.candidate_regression import CandidateFinder
from atoll_coordinator.model.stochastic.likelihood import FittedProcess, ProcessLikelihood, ProcessModel
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset
from atoll_core.expression.program import Program, ProgramBuilder, constant_places
from atoll_core.expression.restrictions import Restrictions, restrictions_of
from atoll_core.expression.writing.expansion import form_of

_LINEARISATIONS: Final = 2
"""Number of linearisations of a process about its smoothed states. After two linearisations, its constants change by
less than 1/100 of their standard errors."""


@dataclass(frozen=True, eq=False)
class ChosenProcess:
    """The law of a process: `fitted` has fitted constants in all equations, except in known equations.

    `variables` are the names of the equations, in their order. `searched` are the indices of equations that are not
    known. `free` are the indices of equations with fitted constants; a component of the diffusion that is zero has no
    constants. Each equation has `alternatives` and obeys its `restrictions`. With the other discretisation, the
    description is longer by `discretisation_nats`. `is_stopped`: the time limit ended the choice.
    """

    process: ProcessRecording
    variables: tuple[str, ...]
    searched: tuple[int, ...]
    free: tuple[int, ...]
    likelihood: ProcessLikelihood
    fitted: FittedProcess
    alternatives: tuple[Sequence[MeasuredProgram], ...]
    restrictions: Sequence[Restrictions]
    discretisation_nats: float
    is_stopped: bool = False


class ProcessChoice:
    """Chooses the equations of one process."""

    def __init__(
        self, dataset: Dataset, process: ProcessRecording, config: JobConfig, candidates: Mapping[str, CandidateSet],
        deadline: Deadline,
    ) -> None:  # fmt: skip
        self._deadline = deadline
        self._process, self._candidates = process, candidates
        self._variables = (*process.states, *process.components)
        self._steps: Steps = take_steps(process)
        self._restrictions = [restrictions_of(config, name, dataset.names) for name in self._variables]
        self._likelihood = ProcessLikelihood(self._steps, restrictions=self._restrictions)
        self._finder = CandidateFinder(self._steps, dataset.names, self._variables, config, deadline)
        known = [name for name, candidate_set in candidates.items() if candidate_set.known is not None]
        self._searched = tuple(k for k, name in enumerate(self._variables) if name not in known)
        self._starts: dict[int, list[Program]] = {}
        self._alternatives: list[list[MeasuredProgram]] = [[] for _ in self._variables]

    def choose(self) -> ChosenProcess:
        """Return the law of the process."""
        fitted = self._exchange_until_settled(self._brownian_motion(), tries_neighbours=True)
        fitted, difference = (fitted, 0.0) if any(fitted.model.noise) else self._choose_discretisation(fitted)
        alternatives = tuple(map(_best_of_each_form, self._alternatives))
        free = self._free_equations(fitted.model)
        return ChosenProcess(
            self._process, self._variables, self._searched, free, self._likelihood, fitted, alternatives,
            self._restrictions, difference, self._deadline.has_cut_short,
        )  # fmt: skip

    def _choose_discretisation(self, fitted: FittedProcess) -> tuple[FittedProcess, float]:
        """Choose the discretisation with the shorter description. Return the law with this discretisation, and the
        difference of the lengths in nats.

        One discretisation may need a term of the diffusion that the other does not need. So equations are exchanged
        with both discretisations, unless the likelihood of the same equations already decides.
        """
        stepped = self._fit_as_euler_maruyama(fitted.model)
        if stepped.misfit - fitted.misfit > SETTINGS.inference.distinct_nats:
            return fitted, stepped.misfit - fitted.misfit
        alternatives = [*self._alternatives]
        stepped = self._exchange_until_settled(stepped.model, tries_neighbours=False)
        difference = self._total_length(fitted) - self._total_length(stepped)
        if difference > SETTINGS.inference.distinct_nats:
            return stepped, difference
        self._alternatives = alternatives
        return fitted, max(-difference, 0.0)

    def _total_length(self, fitted: FittedProcess) -> float:
        """Return the description length of the steps and of all equations that were searched."""
        programs = [fitted.model.programs[number] for number in self._searched]
        constants = sum(
            len(constant_places(fitted.model.programs[number])) for number in self._free_equations(fitted.model)
        )
        return system_length(fitted.misfit, programs, constants, constant_nats_of(len(self._steps.lengths)))

    def _exchange_until_settled(self, model: ProcessModel, *, tries_neighbours: bool) -> FittedProcess:
        """Exchange equations in rounds until no exchange improves the model, and return this model. Neighbours of
        candidates are tried in round 1 only."""
        length = math.inf
        for number_of_round in range(SETTINGS.effort.brief_steps):
            before = length
            for number in self._searched:
                model, length = self._exchange_equation(
                    model, number, tries_neighbours=tries_neighbours and number_of_round == 0
                )
            fitted = self._refit(model)
            model = fitted.model
            if before - length < SETTINGS.inference.distinct_nats or self._deadline.is_over:
                break
        return fitted

    def _fit_as_euler_maruyama(self, model: ProcessModel) -> FittedProcess:
        """Return the same equations, fitted to rows as steps of the Euler-Maruyama method.

        In this method, only the drift moves a state that has no noise of its own. So a variance is set to zero if this
        makes the misfit smaller.
        """
        model = replace(model, discretisation="Euler-Maruyama")
        for place, (i, j) in enumerate(model.pairs, start=len(model.drift)):
            if i == j and place in self._searched:
                without, length = self._set_component_to_zero(model, place)
                misfits = (self._likelihood.whiten(one).misfit for one in (without, model))
                if math.isfinite(length) and next(misfits) < next(misfits):
                    model = without
        return self._likelihood.fit(model, self._free_equations(model))

    def _free_equations(self, model: ProcessModel) -> tuple[int, ...]:
        """Return the indices of the equations whose constants are fitted: the searched equations that are not zero."""
        return tuple(number for number in self._searched if not is_zero(model.programs[number]))

    def _brownian_motion(self) -> ProcessModel:
        """Return the model of Brownian motion: constant drifts and diffusions, except for known equations."""
        time = float(self._steps.lengths.sum())
        states = len(self._process.states)
        drift = [_constant(float(increments.sum()) / time) for increments in self._steps.increments]
        rates = [float((self._steps.increments[i] * self._steps.increments[j]).sum()) / time
                 for i, j in self._process.pairs]  # fmt: skip
        programs = [*drift, *map(_constant, rates)]
        for number, name in enumerate(self._variables):
            known = self._candidates[name].known if name in self._candidates else None
            programs[number] = programs[number] if known is None else known
        noise = np.zeros(states) if self._process.noise is None else self._process.noise
        noise = np.where(noise > self._steps.least_variances, noise, 0.0)
        return ProcessModel(
            tuple(programs[:states]), tuple(programs[states:]), self._process.pairs, tuple(noise.tolist())
        )

    def _refit(self, model: ProcessModel) -> FittedProcess:
        """Return the model with all its constants fitted. If there is measurement noise, the likelihood is linearised
        about smoothed states."""
        fitted = self._likelihood.fit(model, self._free_equations(model))
        for _ in range(_LINEARISATIONS if any(model.noise) else 0):
            self._likelihood = ProcessLikelihood(
                self._steps, self._likelihood.smooth_states(fitted.model), self._restrictions
            )
            fitted = self._likelihood.fit(fitted.model, self._free_equations(model))
        return fitted

    def _exchange_equation(
        self, model: ProcessModel, number: int, *, tries_neighbours: bool
    ) -> tuple[ProcessModel, float]:
        """Return the model with the best candidate for one equation, and the length of its description.

        The model is unchanged if no candidate is better. The length counts the steps and this equation.
        """
        self._alternatives[number] = []
        name = self._variables[number]
        if self._is_covariance_without_noise(model, number):
            return model, self._equation_length(self._likelihood.whiten(model).misfit, model.programs[number], 0)
        if tries_neighbours:
            self._starts[number] = self._candidates[name].nearest if name in self._candidates else []
        programs = self._starts[number] = self._finder.find(
            number, model, self._starts[number], tries_neighbours=tries_neighbours
        )
        shortening = Shortening(partial(self._measure, model, number), lambda: self._deadline.is_over, reach=MARGIN)
        best = shortening.find_candidates([model.programs[number], *programs], tries_neighbours=False)[0][0]
        self._alternatives[number] = shortening.measured_programs
        model, length = self._fit_with(model, number, best.program).model, best.length
        if number < len(model.drift):
            return model, length
        without, length_without = self._set_component_to_zero(model, number)
        self._alternatives[number].append(MeasuredProgram(without.programs[number], 0.0, length_without))
        return (without, length_without) if length_without < length else (model, length)

    def _measure(self, model: ProcessModel, number: int, program: Program, most: float) -> MeasuredProgram:
        """Return `program` fitted as one equation of a model, while the other equations are fixed. The length counts
        only this equation."""
        restrictions = self._restrictions[number]
        admitted = restrictions.admitted(program)
        if admitted is None:
            return MeasuredProgram(program, math.inf, math.inf)
        program = admitted if restrictions.bounds is None else restrictions.bounds.clipped(admitted)
        limit = most + MARGIN - self._equation_length(0.0, program, len(constant_places(program)))
        fitted = self._fit_with(model, number, program, limit)
        program = fitted.model.programs[number]
        return MeasuredProgram(
            program, fitted.misfit, self._equation_length(fitted.misfit, program, len(constant_places(program)))
        )

    def _fit_with(self, model: ProcessModel, number: int, program: Program, limit: float = math.inf) -> FittedProcess:
        tried = model.with_program(number, program)
        return self._likelihood.fit(tried, (number,), SETTINGS.selection.least_gain, limit)

    def _set_component_to_zero(self, model: ProcessModel, number: int) -> tuple[ProcessModel, float]:
        """Return the model with one component of the diffusion set to zero, and the length of its description. The
        length is infinite if the component must not be zero.

        If the component is a variance, all components of its state become zero, and the drift is fitted again. Then
        only the noise of other states makes this state uncertain.
        """
        states = len(model.drift)
        i, j = model.pairs[number - states]
        without = model.with_program(number, _constant(0.0))
        if i == j:
            for place, pair in enumerate(model.pairs):
                without = without.with_program(states + place, _constant(0.0)) if i in pair else without
            free = tuple(state for state in (i,) if state in self._searched)
            without = self._likelihood.fit(without, free, SETTINGS.selection.least_gain).model
        is_kept = all(
            self._may_be_zero(component)
            for component, program in enumerate(without.programs[states:], states)
            if is_zero(program) and not is_zero(model.programs[component])
        )
        misfit = self._likelihood.whiten(without).misfit if is_kept else math.inf
        return without, self._equation_length(misfit, without.programs[number], 0)

    def _may_be_zero(self, number: int) -> bool:
        """Tell whether a component of the diffusion may become zero: its equation is searched, and its restrictions
        admit zero."""
        restrictions, zero = self._restrictions[number], _constant(0.0)
        is_within = restrictions.bounds is None or is_zero(restrictions.bounds.clipped(zero))
        return number in self._searched and restrictions.are_kept(zero) and is_within

    def _is_covariance_without_noise(self, model: ProcessModel, number: int) -> bool:
        """Tell whether an equation is the covariance of two noises, and one of these noises is zero."""
        states = len(model.drift)
        if number < states:
            return False
        i, j = model.pairs[number - states]
        variances = [
            model.programs[states + place] for place, pair in enumerate(model.pairs) if pair in ((i, i), (j, j))
        ]
        return i != j and any(map(is_zero, variances))

    def _equation_length(self, misfit: float, program: Program, constants: int) -> float:
        return system_length(misfit, [program], constants, constant_nats_of(len(self._steps.lengths)))


def is_zero(program: Program) -> bool:
    """Tell whether a program is the number zero."""
    return len(program) == 1 and constant_places(program) == [0] and float(program.constants[0]) == 0.0


def _constant(value: float) -> Program:
    builder = ProgramBuilder()
    return builder.program(builder.build(value))


def _best_of_each_form(alternatives: Iterable[MeasuredProgram]) -> list[MeasuredProgram]:
    """Return the best program of each form: an equation that differs only in its constants is not an alternative."""
    best: dict[Hashable, MeasuredProgram] = {}
    for alternative in sorted(alternatives, key=lambda alternative: alternative.length):
        best.setdefault(form_of(alternative.program), alternative)
    return list(best.values())
