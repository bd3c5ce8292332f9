"""The chosen system as it is shown: it is fitted to all rows, its constants are rounded, and it is simulated along
whole trajectories.

`finalize` works in this order:

1. The system is fitted to all rows.
2. Constants become simple numbers where the data support them.
3. Equations are written in their shortest form.
4. Factors of one that the data refute are written as constants.
5. Terms that equations share are fitted together.
6. The shown system is simulated along whole trajectories, if possible.

Steps 2 to 5 are undone if they make the fit worse than allowed. If groups of trajectories have their own constants,
`_show_by_group` replaces steps 2 to 5: `groups.choose_shared_constants` decides which constants groups share.

Doubtful: each step decides alone, and its decision is not tested again after a later step. Standard errors belong to
the shown structure with all constants free, including constants that were replaced by simple numbers.
"""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from atoll_coordinator.data.differentiation.inputs import unknown_variance
from atoll_coordinator.data.recording import InputKind
from atoll_coordinator.model.constants.rounding import ERROR_DIGITS, Estimates, FittedEquations, RoundedEquations
from atoll_coordinator.model.constants.standard_errors import (
    ConstantErrors,
    describe_constants,
    make_explicit_if_free,
    write_refuted_factors,
)
from atoll_coordinator.model.inference.groups import choose_shared_constants
from atoll_coordinator.model.inference.residual_covariance import estimate_variance_inflation, residual_covariances
from atoll_coordinator.model.inference.shared_terms import fit_shared_terms
from atoll_coordinator.model.inference.trajectory_simulation import fit_initial_states
from atoll_coordinator.model.pools import Origin
from atoll_coordinator.model.selection.alternatives import Ranking, rank_alternatives
from atoll_coordinator.model.selection.candidates import form_key
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.piece_lengths import refit_on_all_rows, with_longest_pieces
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.selection.task import ModellingTask, SelectedModel
from atoll_coordinator.model.shooting.fit_result import TrajectoryFit
from atoll_coordinator.model.shooting.system import SharedNumber
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.operators import CONSTANT, SUBTRACT, VARIABLE
from atoll_core.expression.program import Program, constant_places, structure, variables_of
from atoll_core.expression.template import Composition, ConstantSource, written_sources
from atoll_core.expression.unit_coefficients import ExplicitCoefficients, as_written
from atoll_core.expression.writing.expansion import Shape
from atoll_core.expression.writing.shortest import shortest_over


@dataclass(frozen=True, eq=False)
class ShownEquations:
    """Equations as they are shown. `rounded` are the equations with rounded constants, and `fit` is the fit of these
    equations. `explicit` are the equations with written factors of one, and `free` is the fit of `explicit` with all
    constants free.

    `fluxes` are terms that were fitted together, see `Refinement`. If groups of trajectories have their own constants,
    `by_group` has the equations of each group; each fitted number of `free` belongs to one group or to all groups.
    `names` has the name of each constant of each equation that is a parameter of a template. `observations` are the
    programs of measured columns that are computed from states, as they are shown, and `explicit_observations` the
    programs whose constants were fitted; `names` of their constants follow.
    """

    rounded: RoundedEquations
    fit: FittedModel
    explicit: tuple[ExplicitCoefficients, ...]
    free: FittedModel
    fluxes: tuple[tuple[Shape, Mapping[str, float | None]], ...] = ()
    by_group: Sequence[Sequence[Program]] = ()
    names: Sequence[Sequence[str | None]] = ()
    observations: tuple[Program, ...] = ()
    explicit_observations: tuple[ExplicitCoefficients, ...] = ()

    @property
    def programs(self) -> tuple[Program, ...]:
        """The equations as they are shown."""
        return self.rounded.programs


@dataclass(frozen=True, eq=False, kw_only=True)
class FinalModel(ShownEquations):
    """The model on all rows.

    `comparison` fits the constants, in pieces of at most `piece` rows, possibly to a subset of the rows.
    `shown_comparison` simulates the equations as they are shown: over all rows and, if possible, along whole
    trajectories; `shown_fit` is this simulation. `held_out_comparison` contains the held-out trajectories; None if
    there are none. `searched` are the searched programs as they are shown; with a template, they are its unknown parts.
    """

    searched: tuple[Program, ...]
    task: ModellingTask
    ranking: Ranking
    origins: Sequence[Mapping[bytes, Origin]]
    held_out_comparison: ModelComparison | None
    comparison: ModelComparison
    shown_comparison: ModelComparison
    shown_fit: TrajectoryFit
    piece: int

    @property
    def are_errors_summed(self) -> bool:
        """Whether integration errors add up: the equations are simulated along longer pieces than the pieces to which
        constants were fitted."""
        return self.piece < min(self.task.piece, self.task.longest)

    @cached_property
    def visited_points(self) -> FloatArray:
        """The values (V, R) of the variables of the equations at all rows. For states, these are simulated values."""
        measurements = self.shown_comparison.estimator.measurements
        points = np.concatenate([self.shown_fit.simulated, measurements.inputs])
        return points[[measurements.variables.index(name) for name in self.task.dataset.names]]

    @cached_property
    def visited_points_by_group(self) -> list[tuple[Sequence[Program], FloatArray]]:
        """Pairs of equations, as they are shown, and values (V, R) of the variables at the rows to which the equations
        apply: at all rows, or at the rows of each group."""
        measurements = self.shown_comparison.estimator.measurements
        if not self.by_group or measurements.groups is None:
            return [(self.programs, self.visited_points)]
        groups = measurements.groups[measurements.owners_of_rows]
        return [
            (programs, self.visited_points[:, groups == group])
            for group, programs in enumerate(self.by_group)
            if np.any(groups == group)
        ]

    @cached_property
    def columns(self) -> list[int]:
        """For each equation, the measured column (index) by which it is judged: the column of its state. For a hidden
        state, this is the column whose residuals are largest, compared with its noise."""
        measurements = self.shown_comparison.estimator.measurements
        noise = np.maximum(measurements.noise, SETTINGS.common.negligible * measurements.observed_scales)
        worst = int(np.argmax(self.shown_fit.squares / noise**2))
        found = [measurements.column_of(state) for state in range(len(self.task.variables))]
        return [worst if column is None else column for column in found]

    @cached_property
    def residual_covariances(self) -> list[FloatArray] | None:
        """The covariance of the residuals of each state; None if constants were fitted to other rows or pieces."""
        fitted = self.comparison.estimator.measurements
        if fitted.rows != self.shown_comparison.estimator.measurements.rows or self.piece != self.task.piece:
            return None
        return residual_covariances(fitted, self.free.fit)

    def gain_of_unknown_part(self, equation: int) -> float:
        """Return by how many nats the model's description is shorter than without the unknown part of an equation, or
        with a constant in its place; the better one counts. Neither needs the shapes and bounds that the user demanded.

        It is infinite if no such system can be simulated.
        """
        selection = self.ranking.selection
        model, constraints = selection.model, selection.comparison.constraints
        others = {index: own for index, own in constraints.restrictions.items() if index != equation}
        comparison = replace(selection.comparison, constraints=replace(constraints, restrictions=others))
        own, lengths = model.programs[equation], list[float]()
        mean = float(np.mean(values_of(own, self.task.dataset.inputs)))
        nothing = Program.of([(VARIABLE, 0, 0, 0.0), (SUBTRACT, 0, 0, 0.0)])  # 0 without a fitted constant
        for program in (nothing, Program.of([(CONSTANT, 0, 0, mean)]))[: 2 if variables_of(own) else 1]:
            other = comparison.fit_replacement(model, equation, program, SETTINGS.effort.steps)
            other = other or comparison.fit_model(
                [*model.programs[:equation], program, *model.programs[equation + 1 :]]
            )
            lengths.append(math.inf if other is None or not math.isfinite(other.nats) else other.nats)
        return min(lengths) - model.nats

    @cached_property
    def has_forms_of_starts(self) -> bool:
        """Whether the unknown parts have the forms of the functions that stood for them in fits from many starts."""
        programs = self.ranking.selection.model.programs
        return all(
            candidates.simulated is None or structure(program) == structure(candidates.simulated)
            for program, candidates in zip(programs, self.task.candidates.values(), strict=True)
        )

    @cached_property
    def other_minima(self) -> list[tuple[float, FloatArray]]:
        """The other minima of fits from many starts: by how many nats each is worse, and its parameters (P,).

        If the model does not have the forms of these fits, it is fitted from the parameters of each minimum.
        """
        task, selection = self.task, self.ranking.selection
        rivals = () if task.minima is None else task.minima.rivals
        model, comparison = selection.model, selection.comparison
        if self.has_forms_of_starts:
            return [(nats, np.array(values)) for nats, values in rivals]
        minima = list[tuple[float, FloatArray]]()
        for parameters in dict.fromkeys(values for _, values in rivals):
            other = comparison.fit_near(model, np.array(parameters), SETTINGS.effort.steps)
            if other is not None:
                minima.append((other.misfit - model.misfit, other.fit.system.parameter_values))
        return minima

    @cached_property
    def unknown_variances(self) -> list[tuple[str, str, float | None]]:
        """Three values for each input: its name, its symbol, and its `unknown_variance`."""
        recording = self.task.recording
        kinds: Sequence[InputKind | None] = recording.input_kinds or [None] * len(recording.inputs)
        times = [part.times for part in recording.trajectories]
        return [
            (name, symbol, unknown_variance(times, [part.inputs[place] for part in recording.trajectories], kind))
            for place, (name, symbol, kind) in enumerate(
                zip(recording.inputs, recording.input_symbols, kinds, strict=True)
            )
        ]

    def simulate_along(self, comparison: ModelComparison) -> TrajectoryFit | None:
        """Return the shown equations simulated along the trajectories of a comparison, with fitted initial states."""
        return comparison.estimator.fit(self.shown_fit.system, None, SETTINGS.effort.steps)

    def find_origin(self, equation: int, program: Program) -> Origin:
        """Return the origin of a program, for instance the front. `program` must have its fitted constants, not rounded
        ones."""
        if self.task.variables[equation] in self.task.known:
            return "known"
        origins = self.origins[equation]
        return origins.get(form_key(program)) or origins.get(structure(program), "descent")


def finalize(selection: SelectedModel) -> FinalModel | None:
    """Return the chosen system as it is shown; None if it cannot be simulated on all rows."""
    task = selection.task
    origins = tuple(
        candidates.origins(compared)
        for candidates, compared in zip(task.candidates.values(), selection.lists, strict=True)
    )
    ranking = rank_alternatives(selection, task.dataset.inputs)
    whole = refit_on_all_rows(ranking.selection)
    if whole is None:
        return None
    equations = _show_by_group(whole) if task.recording.groups else _show_on_all_rows(whole)
    if equations is None:
        return None
    searched = equations.programs
    whole = replace(whole, task=replace(whole.task, parameters=equations.rounded.parameters))
    task, piece = whole.task, whole.task.piece
    shown_comparison, fit = whole.comparison, equations.fit.fit
    if not equations.by_group:
        task, shown_comparison, fit = _simulate_in_whole(whole.task, whole.comparison, equations)
    held_out_comparison = None
    if any(trajectory.held_out for trajectory in task.recording.trajectories):
        held_out_comparison = task.make_comparison(task.measurements(task.variables, held_out=True), task.variables)
    equations = _compose_shown(whole.comparison, equations)
    return FinalModel(
        **vars(equations), searched=searched, task=task, ranking=ranking, origins=origins,
        held_out_comparison=held_out_comparison, comparison=whole.comparison, shown_comparison=shown_comparison,
        shown_fit=fit, piece=piece,
    )  # fmt: skip


def _show_on_all_rows(whole: SelectedModel) -> ShownEquations | None:
    task, comparison, best = whole.task, whole.comparison, whole.model

    def misfit_increase(programs: Sequence[Program]) -> float:
        fit = fit_initial_states(comparison, programs, best.fit)
        return np.inf if fit is None else comparison.score_fit(fit).misfit - best.misfit

    for programs in (attach_estimates(comparison, best).accept_simple_numbers(misfit_increase), best.programs):
        shown = _show_equations(comparison, best, _shortest_writings(whole, programs))
        if shown is None:
            continue
        written = _write_refuted_factors(task, comparison, shown)
        with_factors = None if written is None else _show_equations(comparison, best, written)
        if with_factors is not None and with_factors.fit.misfit <= shown.fit.misfit:
            shown = with_factors
        shorter = _shortest_writings(whole, shown.programs)
        if sum(map(len, shorter)) < sum(map(len, shown.programs)):  # after rounding, some constants are one, or equal
            shortened = _show_equations(comparison, best, shorter)
            shown = shown if shortened is None or shortened.fit.nats > shown.fit.nats else shortened
        return _share_terms(task, comparison, shown)
    return None


def _show_by_group(whole: SelectedModel) -> ShownEquations | None:
    comparison = whole.comparison
    model = choose_shared_constants(whole, lambda equation, program: _shortest_writing(whole, equation, program))
    errors = estimate_errors(comparison, model)
    values = Estimates(errors.values, errors.finite_covariance).round_values()
    fixed = model.fit.system.with_values(values).with_fixed_constants()
    fit = comparison.estimator.fit(
        fixed, None, SETTINGS.effort.steps, model.fit.starts, model.fit.errors, is_stiff=model.fit.is_stiff
    )
    if fit is None:
        return None
    leading = len(comparison.leading)
    programs = fixed.programs[leading:]
    return ShownEquations(
        RoundedEquations(programs, tuple(() for _ in programs)),
        replace(model, programs=programs, fit_or_summary=fit),
        tuple(map(as_written, programs)),
        model,
        by_group=[fixed.of_group(group).programs[leading:] for group in range(len(whole.task.recording.groups))],
    )


def _shortest_writings(whole: SelectedModel, programs: Sequence[Program]) -> tuple[Program, ...]:
    return tuple(_shortest_writing(whole, equation, program) for equation, program in enumerate(programs))


def _shortest_writing(whole: SelectedModel, equation: int, program: Program) -> Program:
    """Return the shortest form of a program. The program itself is returned if the user gave it, or if the form would
    be too large.

    A constant with bounds is not combined with other constants.
    """
    if equation in whole.comparison.fixed:
        return program
    bounds = whole.comparison.restrictions(equation).bounds
    written = (
        shortest_over(program, whole.task.dataset.inputs) if bounds is None else bounds.written(program) or program
    )
    return written if whole.task.may_be_shown(written) else program


def _share_terms(task: ModellingTask, comparison: ModelComparison, shown: ShownEquations) -> ShownEquations:
    """Return the equations with shared terms fitted together, if this shortens the description."""
    together = fit_shared_terms(comparison, shown.free, shown.programs)
    if together is None or not all(map(task.may_be_shown, together.model.programs)):
        return shown
    refitted = _show_equations(comparison, together.model, together.model.programs, together.numbers)
    if refitted is None:
        return shown
    fluxes = [
        (term.shape, {task.variables[equation]: multiple for equation, multiple in term.multiples.items()})
        for term in together.terms
    ]
    return replace(refitted, fluxes=tuple(fluxes))


def _simulate_in_whole(
    task: ModellingTask, comparison: ModelComparison, shown: ShownEquations
) -> tuple[ModellingTask, ModelComparison, TrajectoryFit]:
    """Return the simulation of the shown equations along whole trajectories and all rows.

    If this simulation fails, return the simulation along the pieces and rows to which the equations were fitted.
    """
    whole, fitted = with_longest_pieces(task), comparison.estimator.measurements.rows
    for here in (whole, task) if whole.piece != task.piece else (task,):
        measurements = here.measurements(here.variables)
        if here.piece != task.piece or measurements.rows > fitted:
            shown_comparison = here.make_comparison(measurements, here.variables, is_precise=True)
            fit = fit_initial_states(shown_comparison, shown.programs, parameters=shown.rounded.parameters)
            if fit is not None:
                return here, shown_comparison, fit
    return task, comparison, shown.fit.fit


def _show_equations(
    comparison: ModelComparison, near: FittedModel, programs: tuple[Program, ...], shared: Collection[SharedNumber] = ()
) -> ShownEquations | None:
    """Return the fitted equations of these structures as they would be shown, for comparison with another model. None
    if the fit fails."""
    explicit, free = _fit_all_constants(comparison, near, programs, shared)
    fitted = comparison.fit_from(near, programs, shared=shared)
    if free is None or fitted is None:
        return None
    errors, is_exact = estimate_errors_of_constants(comparison, free), comparison.score.is_exact(free)
    numbers = fitted.fit.system.searched_numbers[0].tolist()

    def numbers_outside_intervals(rounded: RoundedEquations) -> frozenset[int]:
        """Return the indices of the fitted numbers whose shown value is outside of the 95 % interval."""
        if is_exact:
            return frozenset()  # intervals would only reflect integration errors
        known = describe_constants(comparison.fixed, explicit, rounded.programs, errors)
        searched = (constants for equation, constants in enumerate(known) if equation not in comparison.fixed)
        written = [constant for constants in searched for constant in constants.written]
        pairs = zip(numbers[: len(written)], written, strict=True)  # the other numbers are parameters
        return frozenset(number for number, constant in pairs if not constant.is_within)

    rounded_fit = _round_to_fewest_digits(comparison, fitted, numbers_outside_intervals)
    return None if rounded_fit is None else ShownEquations(*rounded_fit, explicit, free)


def _compose_shown(comparison: ModelComparison, shown: ShownEquations) -> ShownEquations:
    """Return the whole right-hand sides of the equations; without a template, `shown` itself."""
    template = comparison.template
    if not template.sides:
        return shown
    none, explicit, simple = np.zeros(len(template.parameters)), shown.explicit, shown.rounded.simple
    composed, written = (
        template.compose([one.program for one in explicit], none),
        template.compose(shown.programs, none),
    )
    sources = [written.sources(index) for index, _ in enumerate(written.programs)]
    sides = tuple(_compose_side(composed, index, explicit, own) for index, own in enumerate(sources))
    near = [
        tuple(None if one.home is None or not simple[one.home] else simple[one.home][one.number] for one in own)
        for own in sources
    ]
    programs = comparison.equations_of(shown.fit)
    count = len(programs)
    return replace(
        shown,
        observations=shown.fit.fit.system.programs[len(comparison.leading) + count :],
        explicit_observations=sides[count:],
        rounded=RoundedEquations(programs, tuple(near[:count]), (), shown.rounded.parameters),
        fit=replace(shown.fit, programs=programs),
        explicit=sides[:count],
        free=replace(shown.free, programs=comparison.equations_of(shown.free)),
        names=[template.parameter_names(own) for own in sources],
    )


def _compose_side(
    composed: Composition, index: int, explicit: Sequence[ExplicitCoefficients], written: Sequence[ConstantSource]
) -> ExplicitCoefficients:
    """Return a whole side that was composed of the `explicit` programs; its origins only count fitted constants.

    `written` are the origins of the constants of the side as it is shown.
    """
    numbers, sources = {source: number for number, source in enumerate(written)}, composed.sources(index)
    origins = [None if one is None else numbers[one] for _, one in written_sources(sources, explicit)]
    homes = sorted({source.home for source in sources if source.home is not None})
    terms = [term for home in homes for term in explicit[home].terms]
    return ExplicitCoefficients(composed.programs[index], tuple(origins), tuple(terms))


def _write_refuted_factors(
    task: ModellingTask, comparison: ModelComparison, shown: ShownEquations
) -> tuple[Program, ...] | None:
    """Return the programs in which refuted factors of one are written as constants. None if the data refute no
    factor."""
    programs, errors = shown.programs, estimate_errors_of_constants(comparison, shown.free)
    known = describe_constants(comparison.fixed, shown.explicit, programs, errors)
    if not any(constants.refuted_factors for constants in known):
        return None
    written = write_refuted_factors(shown.explicit, shown.free.programs, programs, known)
    return tuple(
        longer if task.may_be_shown(longer) else program for longer, program in zip(written, programs, strict=True)
    )


_Outside = Callable[[RoundedEquations], frozenset[int]]
"""A function of rounded equations. It returns the indices of the fitted numbers whose shown value is outside of the 95
% interval."""


def _round_to_fewest_digits(
    comparison: ModelComparison, fitted: FittedModel, numbers_outside_intervals: _Outside
) -> tuple[RoundedEquations, FittedModel] | None:
    """Return a system with rounded constants. They have the fewest digits with which simulations do not change.

    The simulation is compared with a reference: in the reference, simple numbers are the same, and the other constants
    have all digits. None if the system cannot be simulated. A constant is not replaced by a simple number outside its
    95 % interval.
    """
    *few, most = ERROR_DIGITS
    limit, exact = fitted.misfit + SETTINGS.selection.least_gain, None
    constants = attach_estimates(comparison, fitted)
    for digits in few:
        rounded = _round_to_digits(comparison, fitted, constants, digits, numbers_outside_intervals)
        if rounded is None:
            continue
        if rounded[1].misfit > limit and exact is None:
            exact = _round_to_digits(comparison, fitted, constants, most, numbers_outside_intervals)
            limit = np.inf if exact is None else exact[1].misfit + SETTINGS.selection.least_gain
        if rounded[1].misfit <= limit and not numbers_outside_intervals(rounded[0]):
            return rounded
    return exact or _round_to_digits(comparison, fitted, constants, most, numbers_outside_intervals)


def _round_to_digits(
    comparison: ModelComparison,
    fitted: FittedModel,
    constants: FittedEquations,
    digits: int,
    numbers_outside_intervals: _Outside,
) -> tuple[RoundedEquations, FittedModel] | None:
    rounded, estimates = constants.round_equations(digits), frozenset[int]()
    while not (further := numbers_outside_intervals(rounded)) <= estimates:
        estimates |= further
        rounded = constants.round_equations(digits, estimates)
    fit = fit_initial_states(comparison, rounded.programs, fitted.fit, rounded.parameters)
    return None if fit is None else (rounded, comparison.score_fit(fit))


def _fit_all_constants(
    comparison: ModelComparison, best: FittedModel, shown: Sequence[Program], shared: Collection[SharedNumber]
) -> tuple[tuple[ExplicitCoefficients, ...], FittedModel | None]:
    """Fit the shown system with all its constants free. If possible, factors of one that are not written are also
    fitted, unless they fix the coordinates of hidden states."""
    fix_coordinates = bool(comparison.estimator.measurements.hidden) and not comparison.template.sides
    explicit = tuple(
        make_explicit_if_free(
            program, comparison.restrictions(equation), is_given=fix_coordinates or equation in comparison.fixed
        )
        for equation, program in enumerate(shown)
    )
    nodes = {}
    for equation, (coefficients, program) in enumerate(zip(explicit, shown, strict=True)):
        before = constant_places(program)
        for node, origin in zip(constant_places(coefficients.program), coefficients.origins, strict=True):
            if origin is not None:
                nodes[equation, before[origin]] = (equation, node)
    shared_there = [tuple((nodes[place], multiple) for place, multiple in number) for number in shared]
    free = comparison.fit_from(best, [coefficients.program for coefficients in explicit], shared=shared_there)
    if free is not None:
        return explicit, free
    return tuple(map(as_written, shown)), comparison.fit_from(best, shown, shared=shared)


def attach_estimates(comparison: ModelComparison, model: FittedModel) -> FittedEquations:
    """Return the equations of a model with the estimates of its constants, ready for rounding."""
    system, errors = model.fit.system, estimate_errors(comparison, model)
    restrictions = [comparison.restrictions(equation) for equation in range(len(model.programs))]
    estimates = Estimates(errors.values, errors.finite_covariance)
    return FittedEquations(model.programs, estimates, restrictions, comparison.fixed, *system.searched_numbers)


def estimate_errors(comparison: ModelComparison, model: FittedModel) -> ConstantErrors:
    """Return the standard errors of the fitted numbers, based on the error model by which systems are compared.

    Variances are corrected for the number of fitted numbers, and multiplied by the larger of two factors. The first
    factor is the number of rows per independent row (`Score.inflation`): errors of an equation vary as slowly as the
    states. The second factor allows for a correlation that the rows cannot exclude (`estimate_variance_inflation`).
    """
    fit, system = model.fit, model.fit.system
    counts, inflation = float(comparison.score.counts.sum()), comparison.score.inflation(model)
    noisy = comparison.score.has_independent_errors
    wide = estimate_variance_inflation(comparison.estimator.measurements, fit, noisy) if noisy.any() else 1.0
    left = max(counts - system.count - fit.starts.size, 1.0)
    certain = float(comparison.score.counts @ fit.errors.degrees_of_freedom) / counts
    return ConstantErrors.from_fit(
        system.values, fit.reduced, max(left * certain / inflation, 1.0), max(wide, inflation) * counts / left,
        None if system.lower is None or system.upper is None else (system.lower, system.upper), fit.blocks.gradient,
        np.diag(fit.blocks.normal),
    )  # fmt: skip


def estimate_errors_of_constants(comparison: ModelComparison, model: FittedModel) -> ConstantErrors:
    """Return the errors of all constants of the searched programs of a model, then of the parameters of a template;
    several constants may be multiples of one fitted number."""
    return estimate_errors(comparison, model).for_multiples(*model.fit.system.searched_numbers)
