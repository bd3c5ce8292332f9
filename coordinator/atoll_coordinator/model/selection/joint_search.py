"""A model of all variables from what the search handed on: chosen, fitted and judged by trajectories (ADR 0021).

Candidates of each variable are ranked alone, then jointly, one variable exchanged at a time; from the best systems the
descent looks for shorter descriptions nearby; sums with operators that no search begins with are tried beside its end,
and beside the best candidates of nearly clean tables, where one that is exact ends the choice; constants are made
simple; what remains is assessed. All work is bounded by counts, never by the clock.
"""

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from atoll_coordinator.data.recording import Recording
from atoll_coordinator.model.criteria import is_function
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.refinement import Law, LawsByGroup, Refined, may_be_shown
from atoll_coordinator.model.selection.candidates import CandidateSet, ranked
from atoll_coordinator.model.selection.comparison import Constraints, FittedModel, ModelComparison
from atoll_coordinator.model.selection.grouped_rows import GroupedRows
from atoll_coordinator.model.selection.local_search import LocalSearch
from atoll_coordinator.model.selection.solver_errors import without_solver_errors
from atoll_coordinator.model.shooting.measurements import Measurements, measurements_of
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.model.shooting.system import variable_program
from atoll_coordinator.model.sparse.pursuit import pursue
from atoll_coordinator.model.structure.moves.extensions import extensions, leaps
from atoll_coordinator.model.structure.moves.neighbours import neighbours
from atoll_coordinator.model.structure.moves.reductions import reductions
from atoll_coordinator.model.structure.term_libraries import fractions, libraries
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import BASE_OPERATORS, FURTHER_OPERATORS, JobConfig
from atoll_core.data.dataset import Dataset
from atoll_core.expression.builder import Expression
from atoll_core.expression.operators import BY_NAME
from atoll_core.expression.program import Program
from atoll_core.expression.restrictions import Restrictions, restrictions_of
from atoll_core.expression.writing.shortest import shortest


@dataclass(frozen=True, eq=False)
class SelectedModel:
    """The system that describes the trajectories in the fewest nats: its fit, and the comparison where that was found.

    `lists` are the candidates of each variable that there were to begin with; for the equations of the variables
    `widened`, operators with which no search began were tried.
    """

    task: "ModellingTask"
    comparison: ModelComparison
    model: FittedModel
    lists: Sequence[Sequence[Program]] = ()
    widened: Sequence[str] = ()


@dataclass(frozen=True, eq=False)
class ModellingTask:
    """What is modelled: the variables that have `candidates`, in the order of the equations.

    `settled` are equations that were fitted to noise-free targets; `executor` has the threads that fit systems, none
    when they are fitted one after another; `piece` is how many rows are simulated at a stretch, at most; after the
    `deadline` nothing new is tried; `solver` names the one whose errors have been taken off the recording.
    `among_many` are laws that preparing has found already (None: it has not looked).
    """

    dataset: Dataset
    recording: Recording
    config: JobConfig
    candidates: Mapping[str, CandidateSet]
    settled: Mapping[str, Refined] = field(default_factory=dict)
    executor: Executor | None = None
    piece: int = SETTINGS.shooting.piece
    laws: Mapping[str, Sequence[Law]] = field(default_factory=dict)
    deadline: Deadline | None = None
    solver: str | None = None
    among_many: LawsByGroup | None = None
    _restrictions: dict[str, Restrictions] = field(default_factory=dict, repr=False)

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of the equations."""
        return tuple(self.candidates)

    @cached_property
    def known(self) -> dict[str, Program]:
        """The equations that are given."""
        return {
            name: equation_candidates.known
            for name, equation_candidates in self.candidates.items()
            if equation_candidates.known is not None
        }

    @property
    def is_over(self) -> bool:
        """Whether nothing new is to be begun."""
        return self.deadline is not None and self.deadline.is_over

    @property
    def is_nearly_clean(self) -> bool:
        """Whether the independent errors of all states are too small to hide a term of a law."""
        return all(smoothing.relative_noise < SETTINGS.selection.least_noise for smoothing in self.recording.smoothing)

    def may_be_shown(self, program: Program) -> bool:
        """Tell whether the job's equations may be as large as `program`."""
        return may_be_shown(program, self.config.space.max_size)

    def operators(self, variable: str) -> frozenset[int]:
        """Return the codes of the operators that the equation of `variable` may be made of."""
        return frozenset(BY_NAME[name].code for name in self.config.space.operators_for(variable))

    def further_operators(self, variable: str) -> frozenset[int]:
        """Return the codes of the operators with which no search began and that may be tried for that equation."""
        return frozenset(BY_NAME[name].code for name in self.config.space.further_operators_for(variable))

    def columns(self, variable: str) -> tuple[int, ...]:
        """Return the indices of the variables that the equation of `variable` may use."""
        return self.config.space.columns_for(variable, self.dataset.names)

    def converged(self, name: str) -> Program | None:
        """Return the equation that is known, or that a search of a target without noise has converged to."""
        if name in self.known:
            return self.known[name]
        target = self.dataset.problem(name).target
        if name in self.settled and not target.is_noisy and not self.recording.groups:
            refined = self.settled[name]
            if refined.error <= target.convergence_error(self.config.budget.target_error):
                return shortest(refined.program)
        return None

    def measurements(self, variables: Sequence[str], *, held_out: bool = False) -> Measurements:
        """Return the measurements of a system for these variables."""
        states = [self.recording.states.index(name) for name in variables]
        return measurements_of(self.recording, states, held_out=held_out, piece=self.piece)

    def compared_measurements(self) -> Measurements:
        """Return the measurements of all variables on as many rows as systems of so many are compared on."""
        settings = SETTINGS.selection
        rows = min(settings.compared_rows, settings.compared_numbers // max(len(self.variables), 1))
        return self.measurements(self.variables).thinned(rows)

    def compare(
        self, measurements: Measurements, variables: Sequence[str], *, is_precise: bool = False,
        has_noise: bool = True, measured_rows: int = 0,
    ) -> ModelComparison:  # fmt: skip
        """Return a comparison over these measurements, which may stand for more `measured_rows` of the same time.

        Steps of the integration err by a share of the noise, or as if there were none unless it `has_noise`. They all
        may err to one side, while the noise is averaged over the rows: where it `is_precise`, that share is the one of
        their sum along a piece over the standard error of a mean, and noise is what was found of it, not what an
        interpolation may err by.
        """
        noise = float(measurements.relative_noise.min()) if has_noise else 0.0
        if is_precise and not any(self.dataset.problem(name).target.is_noisy for name in self.candidates):
            noise = 0.0
        error = SETTINGS.selection.tolerated_noise * max(noise, SETTINGS.shooting.exact)
        if is_precise:
            longest = int((measurements.bounds[:, 1] - measurements.bounds[:, 0]).max())
            error /= longest * max(1.0, measured_rows / measurements.rows) * math.sqrt(measurements.rows)
        tolerance = max(error, SETTINGS.selection.tolerated_noise * SETTINGS.shooting.exact)
        fixed = [index for index, name in enumerate(variables) if name in self.known]
        restrictions = {index: self.restrictions(name) for index, name in enumerate(variables)}
        restrictions = {index: restriction for index, restriction in restrictions.items() if not restriction.are_none}
        return ModelComparison(
            MultipleShooting(measurements, tolerance, self.deadline, measured_rows), self.dataset.names, fixed,
            self.leading(variables), self.executor, Constraints(restrictions, self.grouped_rows(variables)),
        )  # fmt: skip

    def restrictions(self, variable: str) -> Restrictions:
        """Return what the equation of `variable` must keep to."""
        if variable not in self._restrictions:
            self._restrictions[variable] = restrictions_of(self.config, variable, self.dataset.names)
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
        """Return the equations of the positions, whose rates are the velocities; none with order 1."""
        if self.recording.order == 1:
            return []
        velocities = [self.recording.velocity_symbols[self.recording.states.index(name)] for name in variables]
        return [variable_program(self.dataset.names.index(velocity)) for velocity in velocities]


def ranked_candidates(task: ModellingTask) -> tuple[ModellingTask, list[list[Program]]]:
    """Return the candidates of each variable, the best first, and the task that they are to be compared for.

    That is the one without the errors of a solver where candidates tell these. Where the equations of converged
    searches, with laws by regression for the rest, give the trajectories up to errors of integration, there are no
    others; where a system of the fronts and of some runners-up leaves noise alone, or none
    can be simulated however short the pieces, there are none but these. Among many variables an equation that has laws
    has no others, unless all have.
    """
    converged = [task.converged(name) for name in task.variables]
    laws = [next((law.program for law in task.laws.get(name, ())), None) for name in task.variables]
    programs = [program or law for program, law in zip(converged, laws, strict=True)]
    whole = [program for program in programs if program is not None]
    if any(converged) and len(whole) == len(programs) and _is_exact(task, whole):
        return task, [[program] for program in whole]
    if task.is_nearly_clean:
        fronts = [
            [task.known[name]] if name in task.known else [member.program for member in reversed(candidates.front)]
            for name, candidates in task.candidates.items()
        ]
        exact = _as_solved(task, fronts) if all(fronts) else None
        if exact is not None:
            return exact
    settled = _settled(task)
    sums = {name: _pursued(task, name) for name in task.variables if name not in {*task.known, *settled}}
    nearest = [settled.get(name) or _compared(task, name, sums, is_brief=True) for name in task.variables]
    shortest_pieces = replace(task, piece=min(task.piece, *SETTINGS.shooting.lengths))
    comparison, best = _begun(task, nearest)
    if best is None and _begun(shortest_pieces, nearest)[1] is None:
        return task, nearest
    if best is not None and task.is_nearly_clean and not comparison.is_exact(best):
        exact = _as_solved(task, [[own, *programs] for own, programs in zip(best.programs, nearest, strict=True)])
        if exact is not None:
            return exact
        further = _with_further_sums(task, comparison, best)
        if further is not best and _is_exact(task, further.programs):
            return task, [[program] for program in further.programs]
    if best is not None and _suffices(task, comparison, best):
        return task, nearest
    return task, [settled.get(name) or _compared(task, name, sums) for name in task.variables]


def _as_solved(
    task: ModellingTask, lists: Sequence[Sequence[Program]]
) -> tuple[ModellingTask, list[list[Program]]] | None:
    """Return the task without the errors of a solver, and the candidates, the law first; None where none tells them."""
    for system in _likely_laws(task, lists):
        exact = without_solver_errors(task, system.fit)
        if exact is not None:
            return exact, [[own, *programs] for own, programs in zip(system.programs, lists, strict=True)]
    return None


def _likely_laws(task: ModellingTask, lists: Sequence[Sequence[Program]]) -> Iterator[FittedModel]:
    """Yield systems that may be the law of a table with a solver's errors, fitted to short pieces.

    Along these the errors do not add up, and terms that describe them gain little: first the system of the shortest
    equations that leaves no more than twice as much of any state as the best of a few, then that.
    """
    task = replace(task, piece=min(task.piece, SETTINGS.shooting.lengths[0]))
    comparison = task.compare(task.compared_measurements(), task.variables)
    steps, longest = SETTINGS.effort.brief_steps, max(map(len, lists))
    systems = [
        [programs[min(rank, len(programs) - 1)] for programs in lists]
        for rank in range(min(longest, SETTINGS.effort.beam))
    ]
    begun = best = next(iter(comparison.fit_all(lambda programs: comparison.fit_model(programs, steps), systems)), None)
    if begun is None or best is None or comparison.is_exact(begun):
        return
    most = SETTINGS.selection.solver_as_good**2 * begun.fit.squares
    while True:
        before = best
        for equation, others in enumerate(lists):
            own = best.programs[equation]
            shorter = [
                other
                for other in (*reductions(own), *others)
                if comparison.length(other) < comparison.length(own) and equation not in comparison.fixed
            ]
            models = comparison.narrow_down(best, equation, shorter, ((steps, len(shorter)),), SETTINGS.effort.work)
            as_good = [model for model in models if np.all(model.fit.squares <= most)]
            best = min(as_good, key=lambda model: comparison.length(model.programs[equation]), default=best)
        if best is before:
            yield best
            if best is not begun:
                yield begun
            return


def _settled(task: ModellingTask) -> dict[str, list[Program]]:
    """Return the laws of the equations that have some among many variables.

    None where all have: together they have not held, and one of them is wrong.
    """
    law_programs = {
        name: [law.program for law in laws if task.may_be_shown(law.program)]
        for name, laws in task.laws.items()
        if laws and laws[0].is_of_rates and laws[0].excess <= SETTINGS.inference.excess
    }
    return law_programs if len(law_programs) < len(task.variables) - len(task.known) else {}


def _begun(task: ModellingTask, lists: Sequence[Sequence[Program]]) -> tuple[ModelComparison, FittedModel | None]:
    """Return the best of a few systems of these candidates, None where none can be simulated, and how it was found."""
    measurements = task.compared_measurements()
    comparison = task.compare(measurements, task.variables)
    return comparison, _combined(comparison, lists) if all(lists) else None


def _pursued(task: ModellingTask, name: str, needed: Collection[int] = (), most: float = math.inf) -> list[Program]:
    """Return sums of a polynomial and of functions for the equation of one variable, see `pursue`."""
    if task.is_over:
        return []
    problem = task.dataset.problem(name)
    parts = [problem.of_group(group) for group in range(len(task.recording.groups))] or [problem]
    operators = task.operators(name) | set(needed)
    return [program for part in parts for program in pursue(part, task.columns(name), operators, needed, most)]


def with_further_operators(selection: SelectedModel) -> SelectedModel:
    """Return the selection, or a shorter description that has operators with which no search began."""
    task, comparison, before = selection.task, selection.comparison, selection.model
    widened = [name for name in task.variables if _may_be_widened(task, name)]
    if not widened or task.is_over:
        return selection
    selection = replace(selection, widened=widened)
    best = _with_further_sums(task, comparison, before)
    if best is before:
        return selection
    best = _search_locally(task, comparison, best, [[program] for program in best.programs])
    return replace(selection, model=comparison.fit_beside(best, best.programs) or best)


def operator_remarks(selection: SelectedModel, shown: Mapping[str, Program]) -> Iterator[str]:
    """Yield a sentence where equations as `shown`, by variable, have further operators, or none of these has helped."""
    programs = [shown[name] for name in selection.widened if name in shown]
    codes = {code for program in programs for code in program.operators.tolist()}
    taken = [name for name in FURTHER_OPERATORS if BY_NAME[name].code in codes]
    begun, further = " ".join(BASE_OPERATORS), ", ".join(FURTHER_OPERATORS)
    if taken:
        yield f"Beside {begun}, {further} were tried; with {', '.join(taken)} the description is shorter."
    elif programs and selection.comparison.has_room(selection.model):
        yield (
            f"{further} were tried as well, since {begun} leave more than noise; no equation with them makes the "
            "description shorter."
        )


def _with_further_sums(task: ModellingTask, comparison: ModelComparison, best: FittedModel) -> FittedModel:
    """Return the best system in which sums with further operators stand for some equations, `best` if it is shorter."""
    lists = [_further_sums(task, comparison, best, equation) for equation in range(len(task.variables))]
    if not any(lists):
        return best
    lists = [[*sums, program] for sums, program in zip(lists, best.programs, strict=True)]
    begun = _combined(comparison, lists)
    start = best if begun is None or begun.nats > best.nats else begun
    shorter = exchange(comparison, start, lists)
    return shorter if shorter.nats < best.nats - SETTINGS.selection.least_gain else best


def _further_sums(task: ModellingTask, comparison: ModelComparison, best: FittedModel, equation: int) -> list[Program]:
    """Return sums with further operators that are not too long to be better than an equation, the best first."""
    name = task.variables[equation]
    if not _may_be_widened(task, name):
        return []
    most = comparison.length(best.programs[equation]) + comparison.room(best)
    sums = _pursued(task, name, task.further_operators(name), most)
    short = [program for program in sums if comparison.length(program) < most and task.may_be_shown(program)]
    alone = task.compare(task.measurements([name]).thinned(SETTINGS.selection.compared_rows), [name])
    return ranked(alone, task.dataset.problem(name), short, ()) if short else []


def _may_be_widened(task: ModellingTask, name: str) -> bool:
    """Tell whether further operators may be tried for an equation: one with a law of rates has no other candidates."""
    has_law = any(law.is_of_rates for law in task.laws.get(name, ()))
    return bool(task.further_operators(name)) and not has_law and name not in task.known


def _suffices(task: ModellingTask, comparison: ModelComparison, best: FittedModel) -> bool:
    """Tell whether a system leaves nothing that a longer one could be worth its length for.

    Not where targets are too uncertain for the search to tell a law from others of the same error: a shorter one may be
    missing then (bar magnets at 5 % of noise).
    """
    targets = (task.dataset.problem(name).target for name in task.variables if name not in task.known)
    if any(target.uncertainty > SETTINGS.inference.largest_uncertainty for target in targets):
        return False
    return not comparison.has_room(comparison.calibrate(best))


def search_jointly(
    task: ModellingTask,
    lists: Sequence[Sequence[Program]],
    begun: Sequence[Program] | None = None,
    is_hopeless: Callable[[SelectedModel], bool] = lambda _: False,
) -> SelectedModel | None:
    """Return the best system of equations, None when none can be simulated.

    Args:
        task: what is modelled.
        lists: candidates of each variable, the best first.
        begun: a system to begin with; the best of a few unless given.
        is_hopeless: tells of the best of the candidates when its neighbours need not be looked at.
    """
    measurements = task.compared_measurements()
    comparison = task.compare(measurements, task.variables)
    best = _combined(comparison, lists) if begun is None else comparison.fit_model(begun)
    if best is None:
        return None
    comparison, best = _without_noise(task, comparison, best)
    best = exchange(comparison, comparison.calibrate(best), lists)
    best = comparison.calibrate(best)
    if comparison.is_exact(best):
        best = _reduced(comparison, best)
    elif not is_hopeless(SelectedModel(task, comparison, best)):
        best = _search_locally(task, comparison, best, lists)
    best = comparison.fit_beside(best, best.programs) or best
    return SelectedModel(task, comparison, best, lists)


def _without_noise(
    task: ModellingTask, comparison: ModelComparison, best: FittedModel
) -> tuple[ModelComparison, FittedModel]:
    """Return comparison and system as without noise where that system shows that there is none, else as they are.

    Of few rows, or of few to a period, a smoother takes for noise what it cannot follow. With steps that err by a share
    of that, needless terms would describe what the integration errs by.
    """
    limit = SETTINGS.selection.least_noise * comparison.estimator.measurements.scales
    observed = comparison.estimator.measurements.observed
    if task.is_nearly_clean or np.any(best.fit.squares > limit[observed] ** 2):
        return comparison, best
    precise = task.compare(comparison.estimator.measurements, task.variables, has_noise=False)
    model = precise.fit_beside(best, best.programs)
    return (comparison, best) if model is None else (precise, model)


def _compared(
    task: ModellingTask, name: str, sums: Mapping[str, Sequence[Program]], *, is_brief: bool = False
) -> list[Program]:
    """Return all candidates of one variable, the best first; if it `is_brief`, no libraries and few runners-up.

    `sums` are those of sparse regression, by variable.
    """
    if name in task.known:
        return [task.known[name]]
    problem = task.dataset.problem(name)
    programs = [task.settled[name].program] if name in task.settled else []
    programs += task.candidates[name].nearest if is_brief else task.candidates[name].programs
    programs += [*(law.program for law in task.laws.get(name, ())), *sums[name]]
    measurements = task.measurements([name]).thinned(SETTINGS.selection.compared_rows)
    comparison = task.compare(measurements, [name])
    best = ranked(comparison, problem, programs, () if is_brief else _libraries(task, name, measurements))
    restrictions = task.restrictions(name)
    admitted = (restrictions.admitted(program) for program in best)
    return [program for program in admitted if program is not None and task.may_be_shown(program)]


def _is_exact(task: ModellingTask, programs: Sequence[Program]) -> bool:
    """Tell whether these equations give the trajectories up to errors of integration."""
    comparison = task.compare(task.compared_measurements(), task.variables, has_noise=False)
    model = comparison.fit_model(programs)
    return model is not None and comparison.is_exact(model)


def _libraries(task: ModellingTask, name: str, measurements: Measurements) -> Iterator[list[Expression]]:
    """Yield the libraries of terms for the equation of one variable."""
    columns, operators = task.columns(name), task.operators(name)
    yield from libraries(columns, operators)
    yield from fractions(columns, operators, _scales(task, measurements))


def _combined(comparison: ModelComparison, lists: Sequence[Sequence[Program]]) -> FittedModel | None:
    """Return the best of a few systems to begin with: the best of each list, one variable's next ones at a time."""
    first = [programs[0] for programs in lists]
    systems = [first] + [
        [*first[:index], program, *first[index + 1 :]]
        for index, programs in enumerate(lists)
        for program in programs[1 : SETTINGS.effort.rounds[1][1] + 1]
    ]
    systems += [
        [programs[min(rank, len(programs) - 1)] for programs in lists]
        for rank in range(1, SETTINGS.effort.rounds[1][1] + 1)
    ]
    models = comparison.fit_all(comparison.fit_model, systems)
    return models[0] if models else None


def exchange(comparison: ModelComparison, best: FittedModel, lists: Sequence[Sequence[Program]]) -> FittedModel:
    """Return the best system that comes of exchanging one variable's program at a time; all of them at first.

    Where the errors are those of the integration, no longer program could make the description shorter.
    """
    if comparison.is_exact(best):
        lengths = [comparison.length(program) for program in best.programs]
        lists = [
            [program for program in programs if comparison.length(program) < length] or [own]
            for programs, length, own in zip(lists, lengths, best.programs, strict=True)
        ]
    tried: Sequence[Sequence[Program]] = lists
    while True:
        before = best.nats
        for equation, programs in enumerate(tried):
            if len(programs) > 1 or programs[0] is not best.programs[equation]:
                models = comparison.narrow_down(best, equation, programs, SETTINGS.effort.rounds, SETTINGS.effort.work)
                if models and models[0].nats < best.nats - SETTINGS.selection.least_gain:
                    best = models[0]
        if best.nats > before - SETTINGS.selection.least_gain or comparison.estimator.work >= SETTINGS.effort.work:
            return best
        tried = [programs[: SETTINGS.effort.kept] for programs in lists]


def _search_locally(
    task: ModellingTask, comparison: ModelComparison, best: FittedModel, lists: Sequence[Sequence[Program]]
) -> FittedModel:
    """Return the end of the descent from the best system.

    Where that leaves noise alone, programs are not tried that are so long that no misfit could make them better.
    """
    room = comparison.room(best)
    has_room = comparison.has_room(best)
    sizes = _scales(task, comparison.estimator.measurements)

    def around(equation: int, program: Program) -> Iterator[Program]:
        name = task.variables[equation]
        operators, columns = task.operators(name), task.columns(name)
        scales = [size if column in columns else 0.0 for column, size in enumerate(sizes)]
        longer = extensions(program, scales, operators) if has_room else ()
        yield from promising(program, (*longer, *neighbours(program, columns, operators)))

    def beyond(equation: int, program: Program) -> Iterator[Program]:
        return promising(program, leaps(program, task.operators(task.variables[equation])))

    def promising(program: Program, others: Iterable[Program]) -> Iterator[Program]:
        most = comparison.length(program) + room
        return (
            candidate for candidate in others if comparison.length(candidate) < most and task.may_be_shown(candidate)
        )

    descent = LocalSearch(comparison, around, comparison.estimator.work + SETTINGS.effort.work, beyond)
    equations = [index for index, _ in enumerate(lists) if index not in comparison.fixed]
    best = descent.improve(best, equations)
    for equation in equations if has_room else ():
        best = _restarted(comparison, descent, best, equation, lists[equation])
    best = exchange(comparison, best, lists)
    return _reduced(comparison, best)


def _reduced(comparison: ModelComparison, best: FittedModel) -> FittedModel:
    """Return a system with whatever its equations can do without left out."""
    last = LocalSearch(comparison, lambda *_: iter(()), comparison.estimator.work + SETTINGS.effort.work)
    for equation in range(len(best.programs)):
        if equation not in comparison.fixed:
            best = last.reduce(best, equation)
    return best


def _restarted(
    comparison: ModelComparison, descent: LocalSearch, best: FittedModel, equation: int, programs: Sequence[Program]
) -> FittedModel:
    """Return the best end of descents that begin with other programs for one equation, all others as they are."""
    effort = SETTINGS.effort
    rounds = (effort.rounds[0], (effort.brief_steps, effort.beam))
    others = comparison.narrow_down(best, equation, programs, rounds, effort.work)
    by_kind = {_kind(model.programs[equation]): model for model in reversed(others)}
    for start in sorted(by_kind.values(), key=lambda model: model.nats):
        if descent.is_exhausted:
            break
        end = descent.improve(start, [equation])
        if end.nats < best.nats - SETTINGS.selection.least_gain:
            best = descent.improve(
                end, [*(index for index in range(len(best.programs)) if index not in comparison.fixed)]
            )
    return best


def _kind(program: Program) -> bool:
    """Return whether a program has functions: descents from other kinds end elsewhere."""
    return any(is_function(code) for code in program.operators.tolist())


def _scales(task: ModellingTask, measurements: Measurements) -> list[float]:
    """Return the size of each variable of the dataset."""
    sizes = dict(zip(measurements.variables, measurements.sizes.tolist(), strict=True))
    return [sizes[name] for name in task.dataset.names]
