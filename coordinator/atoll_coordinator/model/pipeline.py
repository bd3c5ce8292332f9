"""An overview of refining: from the fronts of a search to the displayed model and its verdict.

1. The programs of the search are decoded and joined with guesses and known equations (selection/candidates.py).
2. A stochastic process is fitted by maximum likelihood (stochastic/). The steps below do not apply.
3. Without trajectories, each variable's equation is fitted to its target and judged by its rows
   (regression/equation.py). The steps below do not apply.
4. With trajectories, some equations are first fitted to their targets: the target is noise-free, and its search has
   converged. The fitted equations are candidates.
5. Systems of candidates are fitted to the trajectories and compared; the shortest description is the model. The table
   in selection/model_selection.py lists the order of the proposals, and the condition of each.
6. The model is compared with its alternatives, the errors of its constants are estimated, and it is simulated and
   judged (inference/conclusion.py).

Doubts. If no system of candidates can be simulated, equations are judged by derivatives only; a warning says so. The
result depends on the clock only if the user sets ``--max-time``.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.batches import Batches, spreading
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.inference.conclusion import conclude
from atoll_coordinator.model.inference.remarks import warn_of_random_walk, warn_of_residual_pattern
from atoll_coordinator.model.inference.target_checks import TargetChecks
from atoll_coordinator.model.inference.verdict import judge
from atoll_coordinator.model.pools import FrontMember, LawsByGroup, Pools
from atoll_coordinator.model.refinement import Refined, Refinement
from atoll_coordinator.model.regression.equation import WeightedRows, refine_equation
from atoll_coordinator.model.regression.errors import measure_errors
from atoll_coordinator.model.selection.candidates import CandidateSet, collect_candidates
from atoll_coordinator.model.selection.model_selection import operator_remarks, select_model
from atoll_coordinator.model.selection.shortcut import add_laws, laws_at_noise_level
from atoll_coordinator.model.selection.task import ModellingTask
from atoll_coordinator.model.stochastic.conclusion import summarize_process
from atoll_coordinator.model.stochastic.process_choice import ProcessChoice
from atoll_coordinator.model.structure.constant_units import equation_units
from atoll_core.config import JobConfig
from atoll_core.machine import usable_cores

NOT_SIMULATED: Final = (
    "No system of equations could be simulated along the measured trajectories. The equations shown were fitted to the "
    "derivatives only."
)


OUT_OF_TIME: Final = (
    "The time limit (--max-time) ended the choice of equations early. "
    "The equations shown are the best found until then."
)


def refine_all(
    preparation: Preparation,
    config: JobConfig,
    pools: Pools,
    deadline: Deadline | None = None,
    laws: LawsByGroup | None = None,
    batches: Batches | None = None,
) -> Refinement:
    """Return the refined equation of each variable. A variable is missing if no equation replaces the best member of
    its front (see `refine_equation`).

    Args:
        preparation: the dataset of the search, and the recording unless left-hand sides were given.
        config: the resolved configuration of the job.
        pools: the programs passed from the search to refining, by variable.
        deadline: when refining must return its best result so far; None: never.
        laws: the laws that preparing found, if there are many variables (`sparse.laws`); None: the laws are searched
            here.
        batches: sends batches to workers; None: threads of this process compute everything. The results are equal to
            the bit.
    """
    deadline = deadline or Deadline()
    refined = _refine(preparation, config, pools, deadline, laws, batches)
    if preparation.recording is None and preparation.process is None:
        refined = _judge_by_target(refined, preparation, deadline)
    refinement = _add_units(refined, preparation, config)
    if not deadline.has_cut_short:
        return refinement
    warnings = tuple(warning for warning in refinement.warnings if warning != NOT_SIMULATED)
    return replace(refinement, warnings=(*warnings, OUT_OF_TIME), end="max-time")


def _judge_by_target(refinement: Refinement, preparation: Preparation, deadline: Deadline) -> Refinement:
    """Return the refinement with verdicts by the rows of the targets; for jobs without trajectories."""
    stopped = "the choice of the equation" if deadline.has_cut_short else ""
    equations = {}
    for name, equation in refinement.equations.items():
        problem = (preparation.counted or preparation.dataset).problem(name)
        verdict = judge(TargetChecks(equation, problem, preparation.weights, stopped=stopped))
        equations[name] = replace(equation, **vars(verdict))
    return replace(refinement, equations=equations)


def _add_units(refinement: Refinement, preparation: Preparation, config: JobConfig) -> Refinement:
    """Return the refinement with the findings on units of each equation, if columns have units."""
    if not config.data.units:
        return refinement
    dataset = preparation.dataset
    equations = {
        name: replace(equation, units=equation_units(dataset, config, name, equation.program))
        for name, equation in refinement.equations.items()
    }
    return replace(refinement, equations=equations)


def _refine(
    preparation: Preparation, config: JobConfig, pools: Pools, deadline: Deadline, laws: LawsByGroup | None,
    batches: Batches | None,
) -> Refinement:  # fmt: skip
    candidates = collect_candidates(preparation.dataset, config, pools)
    for name, program in preparation.parts.items():
        candidates[name] = replace(candidates[name], simulated=program)
    if preparation.process is not None:
        choice = ProcessChoice(preparation.dataset, preparation.process, config, candidates, deadline)
        chosen = choice.choose()
        deadline.begin_last_stage()
        return summarize_process(chosen, preparation.dataset, config, candidates)
    if preparation.recording is None:
        return Refinement(_fit_by_regression(preparation, config, candidates, deadline))
    converged = {
        name: programs for name, programs in candidates.items() if _has_converged(preparation, config, name, programs)
    }
    settled = _fit_by_regression(preparation, config, converged, deadline)
    threads = usable_cores(os.environ)[0] if batches is None else batches.threads
    with spreading(batches, threads, deadline) as spread:
        task = add_laws(ModellingTask(
            preparation.dataset, preparation.recording, config, candidates, settled, spread, deadline=deadline,
            among_many=laws, parameters=np.array(preparation.parameters) if preparation.parameters else None,
            minima=preparation.minima,
        ))  # fmt: skip
        selected = select_model(task)
        deadline.begin_last_stage()
        model = None if selected is None else conclude(selected, preparation)
    if selected is not None and model is not None:
        shown = {name: equation.program for name, equation in model.equations.items()}
        time = "t" if preparation.source is None else preparation.source.time or "t"
        remarks = (
            *operator_remarks(selected, shown),
            *warn_of_residual_pattern(preparation.recording, model.equations, time),
        )
        left_out = {name: programs for name, programs in candidates.items() if name not in model.equations}
        alone = _fit_by_regression(preparation, config, left_out, deadline)
        return replace(
            model,
            equations={**alone, **model.equations},
            warnings=(*model.warnings, *remarks),
        )
    unsettled = {name: programs for name, programs in candidates.items() if name not in converged}
    rest = _fit_by_regression(preparation, config, unsettled, deadline)
    if deadline.has_cut_short:
        rest |= _fit_laws(task, [name for name in unsettled if name not in task.known])
    warnings = (NOT_SIMULATED, *warn_of_random_walk(preparation.recording))
    return Refinement({**settled, **rest}, warnings=warnings)


def _has_converged(preparation: Preparation, config: JobConfig, name: str, candidates: CandidateSet) -> bool:
    """Tell whether the search of a target without noise has reached the error at which an equation counts as found."""
    problem = preparation.dataset.problem(name)
    if problem.groups is not None:
        return False  # the search converged on the rows of one group
    target = problem.target
    limit = target.convergence_error(config.budget.target_error)
    return not target.is_noisy and any(member.error <= limit for member in candidates.front)


def _fit_laws(task: ModellingTask, names: Sequence[str]) -> dict[str, Refined]:
    """Return, for the variables `names` that have a law at the noise level, the equation of this law.

    These laws replace the front members if there was no comparison along trajectories. The front member with the best
    fit to the derivatives may contain unnecessary terms.
    """
    equations = {}
    for name in names:
        problem, loss = task.dataset.problem(name), task.config.evolution.loss
        members = [
            FrontMember(law.program, *measure_errors(problem, law.program, loss))
            for law in laws_at_noise_level(task, name)[:1]
        ]
        equation = refine_equation(problem, task.config, members, deadline=task.deadline)
        if equation is not None:
            member = task.candidates[name].member_of(equation.program)
            equations[name] = replace(equation, member=member, origin="library" if member is None else "front")
    return equations


def _fit_by_regression(
    preparation: Preparation, config: JobConfig, candidates: Mapping[str, CandidateSet], deadline: Deadline
) -> dict[str, Refined]:
    """Return the equations of the searched variables, each fitted to its target.

    Errors of left-hand sides given by the user are independent, errors of smoothed derivatives are not. Only
    independent errors give confidence intervals.
    """
    is_given = preparation.recording is None
    weights = preparation.weights if is_given else None
    counted = preparation.counted or preparation.dataset
    equations = {
        name: refine_equation(
            preparation.dataset.problem(name),
            config,
            candidate_set.front,
            WeightedRows(counted.problem(name), weights),
            deadline,
            has_intervals=is_given,
        )
        for name, candidate_set in candidates.items()
        if candidate_set.known is None
    }
    return {name: equation for name, equation in equations.items() if equation is not None}
