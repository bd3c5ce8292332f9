"""The chosen system as it is shown: fitted to all rows, its constants rounded, simulated along whole trajectories.

In this order: the system is fitted to all rows; constants become simple numbers where the data single these out;
equations are written as short as they can be; factors of one that the data refute are written; terms that equations
share are fitted together; the shown system is simulated along whole trajectories, if possible. Each step is kept if the
data are described no worse. Where groups of trajectories have constants of their own, `groups` does all of this
instead.
"""

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
    explicit_coefficients,
    with_refuted_factors,
)
from atoll_coordinator.model.inference.groups import model_of_groups
from atoll_coordinator.model.inference.residual_covariance import residual_covariances, widening
from atoll_coordinator.model.inference.shared_terms import fit_together
from atoll_coordinator.model.inference.trajectory_simulation import fit_starts
from atoll_coordinator.model.pools import Origin
from atoll_coordinator.model.selection.alternatives import Ranking, rank_alternatives
from atoll_coordinator.model.selection.candidates import form_key
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.piece_lengths import refit_on_all_rows, with_longest_pieces
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.selection.task import ModellingTask, SelectedModel
from atoll_coordinator.model.shooting.system import SharedNumber
from atoll_coordinator.model.shooting.trajectory_fit import TrajectoryFit
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import Program, constant_places, structure
from atoll_core.expression.unit_coefficients import ExplicitCoefficients, as_written
from atoll_core.expression.writing.expansion import Shape
from atoll_core.expression.writing.shortest import shortest_over


@dataclass(frozen=True, eq=False)
class ShownEquations:
    """Equations as they are shown: `rounded` and their `fit`; `free` is the fit of `explicit`, all constants free.

    `fluxes` are terms that were fitted together, see `Refinement`. `by_group` are the equations with the constants of
    each group where groups of trajectories have their own; each number of `free` belongs to one group or to all.
    """

    rounded: RoundedEquations
    fit: FittedModel
    explicit: tuple[ExplicitCoefficients, ...]
    free: FittedModel
    fluxes: tuple[tuple[Shape, Mapping[str, float | None]], ...] = ()
    by_group: Sequence[Sequence[Program]] = ()

    @property
    def programs(self) -> tuple[Program, ...]:
        """The equations as they are shown."""
        return self.rounded.programs


@dataclass(frozen=True, eq=False, kw_only=True)
class FinalModel(ShownEquations):
    """The model on all rows.

    `comparison` is where constants are fitted, in pieces of at most `piece` rows; `seen` where the equations are
    simulated as they are shown, over whole trajectories, also where constants are fitted to short pieces of them, and
    over all rows, also where they are fitted to fewer, and `seen_fit` the simulation there. `unseen` is a comparison
    over the held-out trajectories, None when there are none.
    """

    task: ModellingTask
    ranking: Ranking
    origins: Sequence[Mapping[bytes, Origin]]
    unseen: ModelComparison | None
    comparison: ModelComparison
    seen: ModelComparison
    seen_fit: TrajectoryFit
    piece: int

    @property
    def are_errors_summed(self) -> bool:
        """Whether the equations are simulated along longer pieces than the pieces of the fit of constants."""
        return self.piece < min(self.task.piece, self.task.longest)

    @cached_property
    def visited(self) -> FloatArray:
        """The variables of the equations (V, R) at all rows, states as they are simulated."""
        measurements = self.seen.estimator.measurements
        points = np.concatenate([self.seen_fit.simulated, measurements.inputs])
        return points[[measurements.variables.index(name) for name in self.task.dataset.names]]

    @cached_property
    def visited_by_group(self) -> list[tuple[Sequence[Program], FloatArray]]:
        """The equations as they are shown, and the rows (V, R) that they hold for: all, or the rows of each group."""
        measurements = self.seen.estimator.measurements
        if not self.by_group or measurements.groups is None:
            return [(self.programs, self.visited)]
        groups = measurements.groups[measurements.owners_of_rows]
        return [
            (programs, self.visited[:, groups == group])
            for group, programs in enumerate(self.by_group)
            if np.any(groups == group)
        ]

    @cached_property
    def residual_covariances(self) -> list[FloatArray] | None:
        """The covariance of the residuals of each state; None where constants were fitted to other rows than these."""
        fitted = self.comparison.estimator.measurements
        if fitted.rows != self.seen.estimator.measurements.rows or self.piece != self.task.piece:
            return None
        return residual_covariances(fitted, self.free.fit)

    @cached_property
    def unknown_variances(self) -> list[tuple[str, str, float | None]]:
        """Name, symbol and `unknown_variance` of each input."""
        recording = self.task.recording
        kinds: Sequence[InputKind | None] = recording.input_kinds or [None] * len(recording.inputs)
        times = [part.times for part in recording.trajectories]
        return [
            (name, symbol, unknown_variance(times, [part.inputs[place] for part in recording.trajectories], kind))
            for place, (name, symbol, kind) in enumerate(
                zip(recording.inputs, recording.input_symbols, kinds, strict=True)
            )
        ]

    def simulated_by(self, comparison: ModelComparison) -> TrajectoryFit | None:
        """Return the shown equations along the trajectories of a comparison, only initial states being fitted."""
        return comparison.estimator.fit(self.seen_fit.system, None, SETTINGS.effort.steps)

    def origin(self, equation: int, program: Program) -> Origin:
        """Return where a program came from, before its constants were made simple."""
        if self.task.variables[equation] in self.task.known:
            return "known"
        origins = self.origins[equation]
        return origins.get(form_key(program)) or origins.get(structure(program), "descent")


def finalize(selection: SelectedModel) -> FinalModel | None:
    """Return the chosen system as it is shown; None when it cannot be simulated on all rows."""
    task = selection.task
    origins = tuple(
        candidates.origins(compared)
        for candidates, compared in zip(task.candidates.values(), selection.lists, strict=True)
    )
    ranking = rank_alternatives(selection, task.dataset.inputs)
    whole = refit_on_all_rows(ranking.selection)
    if whole is None:
        return None
    equations = _shown_by_group(whole) if task.recording.groups else _shown_on_all_rows(whole)
    if equations is None:
        return None
    task, piece = whole.task, whole.task.piece
    seen, fit = whole.comparison, equations.fit.fit
    if not equations.by_group:
        task, seen, fit = _seen_in_whole(whole.task, whole.comparison, equations)
    unseen = None
    if any(trajectory.held_out for trajectory in task.recording.trajectories):
        unseen = task.make_comparison(task.measurements(task.variables, held_out=True), task.variables)
    return FinalModel(
        **vars(equations), task=task, ranking=ranking, origins=origins, unseen=unseen, comparison=whole.comparison,
        seen=seen, seen_fit=fit, piece=piece,
    )  # fmt: skip


def _shown_on_all_rows(whole: SelectedModel) -> ShownEquations | None:
    task, comparison, best = whole.task, whole.comparison, whole.model

    def growth(programs: Sequence[Program]) -> float:
        fit = fit_starts(comparison, programs, best.fit)
        return np.inf if fit is None else comparison.score_fit(fit).misfit - best.misfit

    for programs in (fitted_equations(comparison, best).simplified(growth), best.programs):
        shown = _show(comparison, best, _shortest_writings(whole, programs))
        if shown is None:
            continue
        written = _without_refuted(task, comparison, shown)
        with_factors = None if written is None else _show(comparison, best, written)
        if with_factors is not None and with_factors.fit.misfit <= shown.fit.misfit:
            shown = with_factors
        shorter = _shortest_writings(whole, shown.programs)
        if sum(map(len, shorter)) < sum(map(len, shown.programs)):  # constants are one or equal as rounded
            shortened = _show(comparison, best, shorter)
            shown = shown if shortened is None or shortened.fit.nats > shown.fit.nats else shortened
        return _with_shared_terms(task, comparison, shown)
    return None


def _shown_by_group(whole: SelectedModel) -> ShownEquations | None:
    comparison = whole.comparison
    model = model_of_groups(whole, lambda equation, program: _shortest_writing(whole, equation, program))
    errors = estimate_errors(comparison, model)
    values = Estimates(errors.values, errors.bounded).rounded()
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
    """Return the shortest writing of a program, unless it is given or would be larger than is allowed.

    Where constants have bounds, the shortest one in which each of them stands by itself.
    """
    if equation in whole.comparison.fixed:
        return program
    bounds = whole.comparison.restrictions(equation).bounds
    written = (
        shortest_over(program, whole.task.dataset.inputs) if bounds is None else bounds.written(program) or program
    )
    return written if whole.task.may_be_shown(written) else program


def _with_shared_terms(task: ModellingTask, comparison: ModelComparison, shown: ShownEquations) -> ShownEquations:
    """Return the equations with the terms that they share fitted together, if the data allow it."""
    together = fit_together(comparison, shown.free, shown.programs)
    if together is None or not all(map(task.may_be_shown, together.model.programs)):
        return shown
    refitted = _show(comparison, together.model, together.model.programs, together.numbers)
    if refitted is None:
        return shown
    fluxes = [
        (term.shape, {task.variables[equation]: multiple for equation, multiple in term.multiples.items()})
        for term in together.terms
    ]
    return replace(refitted, fluxes=tuple(fluxes))


def _seen_in_whole(
    task: ModellingTask, comparison: ModelComparison, shown: ShownEquations
) -> tuple[ModellingTask, ModelComparison, TrajectoryFit]:
    """Return the equations as they are shown along whole trajectories and all rows, if they can be simulated there.

    Else along the trajectories that they were fitted to.
    """
    whole, fitted = with_longest_pieces(task), comparison.estimator.measurements.rows
    for here in (whole, task) if whole.piece != task.piece else (task,):
        measurements = here.measurements(here.variables)
        if here.piece != task.piece or measurements.rows > fitted:
            seen = here.make_comparison(measurements, here.variables, is_precise=True)
            fit = fit_starts(seen, shown.programs)
            if fit is not None:
                return here, seen, fit
    return task, comparison, shown.fit.fit


def _show(
    comparison: ModelComparison, near: FittedModel, programs: tuple[Program, ...], shared: Collection[SharedNumber] = ()
) -> ShownEquations | None:
    """Return equations of these structures as they are shown, fitted for comparison with another model; None if that
    fails."""
    explicit, free = _freed(comparison, near, programs, shared)
    fitted = comparison.fit_from(near, programs, shared=shared)
    if free is None or fitted is None:
        return None
    errors, is_exact = errors_of_constants(comparison, free), comparison.score.is_exact(free)
    numbers = fitted.fit.system.columns[0].tolist()

    def outside(rounded: RoundedEquations) -> frozenset[int]:
        """Return the fitted numbers, by index, of constants that lie outside of their intervals as they are shown."""
        if is_exact:
            return frozenset()  # intervals would follow from integration errors
        known = describe_constants(comparison.fixed, explicit, rounded.programs, errors)
        sought = (constants for equation, constants in enumerate(known) if equation not in comparison.fixed)
        written = (constant for constants in sought for constant in constants.written)
        return frozenset(number for number, constant in zip(numbers, written, strict=True) if not constant.is_within)

    rounded_fit = _rounded(comparison, fitted, outside)
    return None if rounded_fit is None else ShownEquations(*rounded_fit, explicit, free)


def _without_refuted(
    task: ModellingTask, comparison: ModelComparison, shown: ShownEquations
) -> tuple[Program, ...] | None:
    """Return the programs with those factors of one written out that the data refute; None without such factors."""
    programs, errors = shown.programs, estimate_errors(comparison, shown.free)
    known = describe_constants(comparison.fixed, shown.explicit, programs, errors)
    if not any(constants.refuted_factors for constants in known):
        return None
    written = with_refuted_factors(shown.explicit, shown.free.programs, programs, known)
    return tuple(
        longer if task.may_be_shown(longer) else program for longer, program in zip(written, programs, strict=True)
    )


_Outside = Callable[[RoundedEquations], frozenset[int]]
"""Tells the fitted numbers, by index, of constants that lie outside of their intervals."""


def _rounded(
    comparison: ModelComparison, fitted: FittedModel, outside: _Outside
) -> tuple[RoundedEquations, FittedModel] | None:
    """Return a system with constants as they are shown, in the fewest digits that do not change simulations.

    They are compared with simulations by the same simple numbers and all digits of the other constants. None when it
    cannot be simulated. Constants that would lie outside of their intervals are not made simple.
    """
    *few, most = ERROR_DIGITS
    limit, exact = fitted.misfit + SETTINGS.selection.least_gain, None
    constants = fitted_equations(comparison, fitted)
    for digits in few:
        rounded = _with_digits(comparison, fitted, constants, digits, outside)
        if rounded is None:
            continue
        if rounded[1].misfit > limit and exact is None:
            exact = _with_digits(comparison, fitted, constants, most, outside)
            limit = np.inf if exact is None else exact[1].misfit + SETTINGS.selection.least_gain
        if rounded[1].misfit <= limit and not outside(rounded[0]):
            return rounded
    return exact or _with_digits(comparison, fitted, constants, most, outside)


def _with_digits(
    comparison: ModelComparison, fitted: FittedModel, constants: FittedEquations, digits: int, outside: _Outside
) -> tuple[RoundedEquations, FittedModel] | None:
    rounded, estimates = constants.rounded(digits), frozenset[int]()
    while not (further := outside(rounded)) <= estimates:
        estimates |= further
        rounded = constants.rounded(digits, estimates)
    fit = fit_starts(comparison, rounded.programs, fitted.fit)
    return None if fit is None else (rounded, comparison.score_fit(fit))


def _freed(
    comparison: ModelComparison, best: FittedModel, shown: Sequence[Program], shared: Collection[SharedNumber]
) -> tuple[tuple[ExplicitCoefficients, ...], FittedModel | None]:
    """Fit the shown system with all its constants free, if possible also factors of one that are not written."""
    explicit = tuple(
        explicit_coefficients(program, comparison.restrictions(equation), is_given=equation in comparison.fixed)
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


def fitted_equations(comparison: ModelComparison, model: FittedModel) -> FittedEquations:
    """Return the equations of a model with the estimates of its constants, for rounding."""
    system, errors = model.fit.system, estimate_errors(comparison, model)
    restrictions = [comparison.restrictions(equation) for equation in range(len(model.programs))]
    estimates = Estimates(errors.values, errors.bounded)
    return FittedEquations(
        model.programs, estimates, restrictions, comparison.fixed, system.columns[0], system.multiples
    )


def estimate_errors(comparison: ModelComparison, model: FittedModel) -> ConstantErrors:
    """Return the errors of the fitted numbers, by the errors of measurement by which systems are compared.

    Variances are corrected for the fitted numbers, and multiplied by the number of rows that count as one
    (`ModelComparison.inflation`), since the errors of an equation vary as slowly as the states; or by the factor of a
    correlation that the rows do not exclude, if that is larger.
    """
    fit, system = model.fit, model.fit.system
    counts, inflation = float(comparison.score.counts.sum()), comparison.score.inflation(model)
    noisy = comparison.score.has_independent_errors
    wide = widening(comparison.estimator.measurements, fit, noisy) if noisy.any() else 1.0
    left = max(counts - system.count - fit.starts.size, 1.0)
    certain = float(comparison.score.counts @ fit.errors.degrees_of_freedom) / counts
    return ConstantErrors.of_fit(
        system.values, fit.reduced, max(left * certain / inflation, 1.0), max(wide, inflation) * counts / left,
        None if system.lower is None or system.upper is None else (system.lower, system.upper), fit.gradient,
        np.diag(fit.normal),
    )  # fmt: skip


def errors_of_constants(comparison: ModelComparison, model: FittedModel) -> ConstantErrors:
    """Return the errors of all constants of a model, which may be multiples of fewer fitted numbers."""
    system = model.fit.system
    return estimate_errors(comparison, model).of_multiples(system.columns[0], system.multiples)
