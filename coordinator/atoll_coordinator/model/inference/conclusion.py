"""From the chosen system to what is reported: constants with errors, alternatives, verdicts, simulations."""

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from atoll_coordinator.data.differentiation.inputs import unknown_variance
from atoll_coordinator.data.differentiation.kernels.stencils import HALF_WIDTHS
from atoll_coordinator.data.recording import InputKind, Recording, Smoothing
from atoll_coordinator.model.criteria import structure_length
from atoll_coordinator.model.inference.attractor import look_for_chaos, may_be_chaotic
from atoll_coordinator.model.inference.checks import Evidence
from atoll_coordinator.model.inference.null_models import log_bayes_factor, squared_steps, structure_price
from atoll_coordinator.model.inference.prediction import Rival, draws, foretell
from atoll_coordinator.model.inference.residual_covariance import residual_covariance
from atoll_coordinator.model.inference.residuals import ReferenceSmoother
from atoll_coordinator.model.inference.shared_terms import fit_together
from atoll_coordinator.model.inference.standard_errors import (
    Errors,
    describe_constants,
    estimate_errors,
    find_correlations,
    joint_covariance,
)
from atoll_coordinator.model.inference.trajectory_simulation import (
    bands,
    fit_starts,
    not_simulated,
    r2_of,
    scaled_covariance,
    simulated,
)
from atoll_coordinator.model.inference.verdict import judge
from atoll_coordinator.model.pools import Origin
from atoll_coordinator.model.refinement import (
    Alternative,
    Chaos,
    Prediction,
    Refined,
    Refinement,
    SharedTerm,
    Simulated,
    Simulation,
    StateErrors,
)
from atoll_coordinator.model.regression.covariance import Known, student_95
from atoll_coordinator.model.regression.errors import grouped_errors_on
from atoll_coordinator.model.regression.fit import contains
from atoll_coordinator.model.regression.rounding import ERROR_DIGITS
from atoll_coordinator.model.selection.alternatives import Ranking, rank_alternatives
from atoll_coordinator.model.selection.candidates import form
from atoll_coordinator.model.selection.comparison import FittedModel, ModelComparison
from atoll_coordinator.model.selection.piece_lengths import in_whole, on_all_rows, remarks
from atoll_coordinator.model.selection.rounding import RoundedSystem, ShownConstants, round_system
from atoll_coordinator.model.selection.shortcut import predictable_rows
from atoll_coordinator.model.selection.task import ModellingTask, SelectedModel
from atoll_coordinator.model.shooting.measurements import Measurements
from atoll_coordinator.model.shooting.noise import estimate_variances, roughness
from atoll_coordinator.model.shooting.system import SharedNumber
from atoll_coordinator.model.shooting.trajectory_fit import TrajectoryFit, growth_rate, speed_growth
from atoll_coordinator.model.structure.poles import find_poles
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import EXACT_ERROR, FloatArray
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import Program, constant_places, structure, variables_of
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.unit_coefficients import (
    ExplicitCoefficients,
    as_written,
    make_coefficients_explicit,
    write_factors,
)
from atoll_core.expression.writing.expansion import expand_program
from atoll_core.expression.writing.shortest import shortest_over


@dataclass(frozen=True, eq=False)
class Shown:
    """Equations as they are shown: `rounded` and their `fit`; `free` is that of `explicit`, all constants free.

    Terms that they share were fitted together.
    """

    rounded: RoundedSystem
    fit: FittedModel
    explicit: tuple[ExplicitCoefficients, ...]
    free: FittedModel
    shared_terms: tuple[SharedTerm, ...] = ()


@dataclass(frozen=True, eq=False)
class Final:
    """The model on all rows.

    `comparison` is where constants are fitted, in pieces of at most `piece` rows; `seen` where the equations are
    simulated as they are shown, over whole trajectories, also where constants are fitted to short pieces of them, and
    over all rows, also where they are fitted to fewer, and `seen_fit` what that gives. `unseen` is a
    comparison over the held-out trajectories, None when there are none. `by_group` has the equations with the constants
    of each group of trajectories, where these have constants of their own.
    """

    task: ModellingTask
    ranking: Ranking
    origins: Sequence[Mapping[bytes, Origin]]
    unseen: ModelComparison | None
    comparison: ModelComparison
    equations: Shown
    seen: ModelComparison
    seen_fit: TrajectoryFit
    piece: int
    by_group: Sequence[Sequence[Program]] = ()

    @property
    def shown(self) -> tuple[Program, ...]:
        """The equations as they are shown."""
        return self.equations.rounded.programs

    @cached_property
    def fitted(self) -> tuple[float, ...]:
        """How many numbers were fitted to the measurements of each state, see `_fitted_to`."""
        return tuple(_fitted_to(self, index) for index, _ in enumerate(self.task.variables))

    @cached_property
    def null_nats(self) -> tuple[float, ...]:
        """By how many nats each equation describes its state better than no equation does, see `_null_nats`."""
        return tuple(_null_nats(self, index, self.fitted[index]) for index, _ in enumerate(self.task.variables))

    @cached_property
    def visited(self) -> FloatArray:
        """The variables of the equations (V, R) at all rows, states as they are simulated."""
        measurements = self.seen.estimator.measurements
        points = np.concatenate([self.seen_fit.simulated, measurements.inputs])
        return points[[measurements.variables.index(name) for name in self.task.dataset.names]]

    @cached_property
    def by_rows(self) -> list[tuple[Sequence[Program], FloatArray]]:
        """The equations as they are shown, and the rows (V, R) that they hold for: all, or those of each group."""
        measurements = self.seen.estimator.measurements
        if not self.by_group or measurements.groups is None:
            return [(self.shown, self.visited)]
        groups = measurements.groups[measurements.owners_of_rows]
        return [
            (programs, self.visited[:, groups == group])
            for group, programs in enumerate(self.by_group)
            if np.any(groups == group)
        ]

    @cached_property
    def unknown_inputs(self) -> list[tuple[str, str, float | None]]:
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

    @property
    def explicit(self) -> tuple[ExplicitCoefficients, ...]:
        """The equations with their factors of one as constants."""
        return self.equations.explicit

    @property
    def free(self) -> FittedModel:
        """The fit of `explicit`, all constants free."""
        return self.equations.free

    @property
    def are_errors_summed(self) -> bool:
        """Whether the equations are simulated along longer pieces than those that constants are fitted to."""
        return self.piece < min(self.task.piece, self.task.longest)

    def origin(self, equation: int, program: Program) -> Origin:
        """Return where a program came from, before its constants were made simple."""
        if self.task.variables[equation] in self.task.known:
            return "known"
        origins = self.origins[equation]
        return origins.get(form(program)) or origins.get(structure(program), "descent")


@dataclass(frozen=True, eq=False)
class LongRun:
    """What is known of a model along trajectories that are longer than the pieces of its fit.

    It `fits` them in whole up to their noise or not, None where that is not known, as where there is or may be `chaos`.
    `r2` has the R2 of each state by simulations of whole trajectories of the equations as they are shown, only the
    initial states fitted; None where they were not simulated, minus infinity where they could not be. Of a driven model
    whose errors grow as those of chaos do `predictable_rows` can be predicted, where that is less than a piece.
    """

    fits: bool | None
    chaos: Chaos | None
    r2: Sequence[float | None] | None = None
    predictable_rows: int | None = None


@dataclass(frozen=True, eq=False)
class HeldOut:
    """The simulations of trajectories that took no part, and their R2 by variable."""

    trajectories: tuple[Simulated, ...]
    r2: tuple[float | None, ...]


def summarize(selection: SelectedModel) -> Refinement | None:
    """Return the refinement that the chosen system gives; None when it cannot be simulated on all rows."""
    candidates = selection.task.candidates.values()
    origins = tuple(
        equation_candidates.origins(compared)
        for equation_candidates, compared in zip(candidates, selection.lists, strict=True)
    )
    final = _finalized(rank_alternatives(selection, selection.task.dataset.inputs), origins)
    if final is None:
        return None
    task = final.task
    errors = estimate_errors(final.comparison, final.free)
    of_constants = errors.of_constants(final.free.fit.system)
    described = describe_constants(final.comparison, final.explicit, final.shown, of_constants)
    constants = [
        known.with_simple(simple) for known, simple in zip(described, final.equations.rounded.simple, strict=True)
    ]
    out = None if final.unseen is None else _held_out(final, final.unseen, final.shown, errors)
    long_run = long_run_of(final)
    chaos = long_run.chaos
    predictions = predictions_of(final, errors, is_near=chaos is not None and chaos.is_kept)
    equations = {
        name: refined_equation(
            final,
            index,
            constants[index],
            _prediction_r2(final, out, index),
            predictions[index],
            long_run,
        )
        for index, name in enumerate(task.variables)
    }
    measurements = final.seen.estimator.measurements
    if measurements.rows > final.comparison.estimator.measurements.rows:
        spread = _carried_bands(final, final.seen, final.seen_fit, errors)
    else:
        spread = bands(measurements, final.free.fit, *scaled_covariance(final.free.fit, errors))
    trajectories = simulated(measurements, final.seen_fit, spread, task.variables, held_out=False)
    return Refinement(
        equations,
        Simulation(
            task.variables,
            (*trajectories, *(out.trajectories if out is not None else ())),
            student_95(errors.degrees_of_freedom),
        ),
        find_correlations(final.comparison, task.variables, final.explicit, of_constants),
        state_errors(final),
        (*remarks(task, is_tested_in_whole=long_run.fits is True), *pole_remarks(final)),
        chaos,
        shared_terms=final.equations.shared_terms,
        covariance=joint_covariance(final.comparison, task.variables, final.explicit, of_constants),
    )


def pole_remarks(final: Final) -> Iterator[str]:
    """Yield a sentence for each pole of an equation in the region that the data visit."""
    dataset = final.task.dataset
    for name, program in zip(final.task.variables, final.shown, strict=True):
        for part in find_poles(program, dataset.inputs):
            where = to_infix(part, dataset.names)
            yield f"The equation of {name} has a pole within the region that was measured, where {where} is 0."


def state_errors(final: Final) -> dict[str, StateErrors]:
    """Return what is known of the errors of each state, by name."""
    comparison, fit = final.comparison, final.free.fit
    if comparison.is_exact(final.free):
        return {}  # those of the integration, of which nothing is to be said
    bounds = comparison.estimator.measurements.bounds
    rows = np.minimum(comparison.misfit.effective_rows(comparison.squares(fit)), comparison.counts / fit.errors.lengths)
    errors_by_state, variances = {}, estimate_variances(final.task.recording)
    for index, name in enumerate(final.task.variables):
        share, decay = float(fit.errors.shares[index]), float(fit.errors.decays[index])
        errors_by_state[name] = StateErrors(
            float(np.sqrt(fit.squares[index])),
            variances[final.task.recording.states.index(name)].proportional,
            share,
            1.0 / (1.0 - decay) if share else None,
            float(rows[index]),
            final.are_errors_summed,
            int((bounds[:, 1] - bounds[:, 0]).max()) if final.are_errors_summed else None,
        )
    return errors_by_state


def _finalized(ranking: Ranking, origins: Sequence[Mapping[bytes, Origin]]) -> Final | None:
    """Fit the chosen system to all rows, make its constants simple, and fit what is shown again."""
    whole = on_all_rows(ranking.selection)
    if whole is None:
        return None
    comparison, best = whole.comparison, whole.model
    for programs in (
        round_system(comparison, best),
        best.programs,
    ):
        tidy = tuple(
            shortest_writing(whole.task, comparison, equation, program) for equation, program in enumerate(programs)
        )
        shown = _show(comparison, best, tidy)
        if shown is None:
            continue
        written = _without_refuted(whole.task, comparison, shown)
        with_factors = None if written is None else _show(comparison, best, written)
        if with_factors is not None and with_factors.fit.misfit <= shown.fit.misfit:
            shown = with_factors
        shown = _shortened(whole.task, comparison, best, shown)
        shown = _with_shared_terms(whole.task, comparison, shown)
        task, seen, fit = seen_in_whole(whole.task, comparison, shown)
        piece = whole.task.piece
        return Final(task, ranking, origins, unseen_comparison(task), comparison, shown, seen, fit, piece)
    return None


def _shortened(task: ModellingTask, comparison: ModelComparison, near: FittedModel, shown: Shown) -> Shown:
    """Return what is shown without constants that are one or equal as rounded, if the description is no longer."""
    programs = shown.rounded.programs
    shorter = tuple(shortest_writing(task, comparison, equation, program) for equation, program in enumerate(programs))
    if sum(map(len, shorter)) >= sum(map(len, programs)):
        return shown
    shortened = _show(comparison, near, shorter)
    return shown if shortened is None or shortened.fit.nats > shown.fit.nats else shortened


def _with_shared_terms(task: ModellingTask, comparison: ModelComparison, shown: Shown) -> Shown:
    """Return what is shown with the terms that equations share fitted together, if the data allow it."""
    together = fit_together(comparison, shown.free, shown.rounded.programs)
    if together is None or not all(map(task.may_be_shown, together.model.programs)):
        return shown
    refitted = _show(comparison, together.model, together.model.programs, together.numbers)
    if refitted is None:
        return shown
    terms = tuple(
        SharedTerm(term.shape, {task.variables[equation]: multiple for equation, multiple in term.multiples.items()})
        for term in together.terms
    )
    return replace(refitted, shared_terms=terms)


def seen_in_whole(
    task: ModellingTask, comparison: ModelComparison, shown: Shown
) -> tuple[ModellingTask, ModelComparison, TrajectoryFit]:
    """Return the equations as they are shown along whole trajectories and all rows, if they can be.

    Else along those that they were fitted to.
    """
    whole, fitted = in_whole(task), comparison.estimator.measurements.rows
    for here in (whole, task) if whole.piece != task.piece else (task,):
        measurements = here.measurements(here.variables)
        if here.piece != task.piece or measurements.rows > fitted:
            seen = here.compare(measurements, here.variables, is_precise=True)
            fit = fit_starts(seen, shown.rounded.programs)
            if fit is not None:
                return here, seen, fit
    return task, comparison, shown.fit.fit


def _show(
    comparison: ModelComparison, near: FittedModel, programs: tuple[Program, ...], shared: Collection[SharedNumber] = ()
) -> Shown | None:
    """Return equations of these structures as they are shown, fitted beside another model; None if they cannot be."""
    explicit, free = _freed(comparison, near, programs, shared)
    fitted = comparison.fit_beside(near, programs, shared=shared)
    if free is None or fitted is None:
        return None
    errors, is_exact = estimate_errors(comparison, free).of_constants(free.fit.system), comparison.is_exact(free)
    numbers = fitted.fit.system.columns[0].tolist()

    def outside(rounded: RoundedSystem) -> frozenset[int]:
        """Return the fitted numbers, by index, of constants that lie outside of their intervals as they are shown."""
        if is_exact:
            return frozenset()  # intervals are those of the integration's errors
        known = describe_constants(comparison, explicit, rounded.programs, errors)
        sought = (constants for equation, constants in enumerate(known) if equation not in comparison.fixed)
        written = (constant for constants in sought for constant in constants.written)
        return frozenset(number for number, constant in zip(numbers, written, strict=True) if not constant.is_within)

    rounded_fit = _rounded(comparison, fitted, outside)
    return None if rounded_fit is None else Shown(*rounded_fit, explicit, free)


def _without_refuted(task: ModellingTask, comparison: ModelComparison, shown: Shown) -> tuple[Program, ...] | None:
    """Return the programs with those factors of one written out that the data refute; None where there are none."""
    programs = shown.rounded.programs
    known = describe_constants(comparison, shown.explicit, programs, estimate_errors(comparison, shown.free))
    if not any(constants.refuted_factors for constants in known):
        return None
    written = []
    for coefficients, fitted, constants, program in zip(
        shown.explicit, shown.free.programs, known, programs, strict=True
    ):
        made = write_factors(coefficients, fitted, constants.refuted_factors) if constants.refuted_factors else program
        written.append(made if task.may_be_shown(made) else program)
    return tuple(written)


_Outside = Callable[[RoundedSystem], frozenset[int]]
"""Tells the fitted numbers, by index, of constants that lie outside of their intervals."""


def _rounded(
    comparison: ModelComparison, fitted: FittedModel, outside: _Outside
) -> tuple[RoundedSystem, FittedModel] | None:
    """Return a system with constants as they are shown, in as few digits as leave simulations as they are.

    They are compared with those of the same simple numbers and all digits of the other constants. None when it cannot
    be simulated. Constants that would lie outside of their intervals are not made simple.
    """
    *few, most = ERROR_DIGITS
    limit, exact = fitted.misfit + SETTINGS.selection.least_gain, None
    constants = ShownConstants(comparison, fitted)
    for digits in few:
        rounded = _with_digits(comparison, fitted, constants, digits, outside)
        if rounded is None:
            continue
        if rounded[1].misfit > limit and exact is None:
            exact = _with_digits(comparison, fitted, constants, most, outside)
            limit = math.inf if exact is None else exact[1].misfit + SETTINGS.selection.least_gain
        if rounded[1].misfit <= limit and not outside(rounded[0]):
            return rounded
    return exact or _with_digits(comparison, fitted, constants, most, outside)


def _with_digits(
    comparison: ModelComparison, fitted: FittedModel, constants: ShownConstants, digits: int, outside: _Outside
) -> tuple[RoundedSystem, FittedModel] | None:
    rounded, estimates = constants.rounded(digits), frozenset[int]()
    while not (further := outside(rounded)) <= estimates:
        estimates |= further
        rounded = constants.rounded(digits, estimates)
    fit = fit_starts(comparison, rounded.programs, fitted.fit)
    return None if fit is None else (rounded, comparison.measure(fit))


def shortest_writing(task: ModellingTask, comparison: ModelComparison, equation: int, program: Program) -> Program:
    """Return the shortest writing of a program, unless it is given or would be larger than is allowed.

    Where constants have bounds, the shortest one in which each of them stands by itself.
    """
    if equation in comparison.fixed:
        return program
    bounds = comparison.restrictions(equation).bounds
    made = shortest_over(program, task.dataset.inputs) if bounds is None else bounds.written(program) or program
    return made if task.may_be_shown(made) else program


def _freed(
    comparison: ModelComparison, best: FittedModel, shown: Sequence[Program], shared: Collection[SharedNumber]
) -> tuple[tuple[ExplicitCoefficients, ...], FittedModel | None]:
    """Fit what is shown with all its constants free, factors of one that are not written among them if that can be."""
    explicit = tuple(
        as_written(program)
        if equation in comparison.fixed or comparison.restrictions(equation).bounds is not None
        else make_coefficients_explicit(program)
        for equation, program in enumerate(shown)
    )
    free = comparison.fit_beside(
        best, [coefficients.program for coefficients in explicit], shared=_in_explicit(explicit, shown, shared)
    )
    if free is not None:
        return explicit, free
    return tuple(map(as_written, shown)), comparison.fit_beside(best, shown, shared=shared)


def _in_explicit(
    explicit: Sequence[ExplicitCoefficients], shown: Sequence[Program], shared: Collection[SharedNumber]
) -> list[SharedNumber]:
    """Return shared numbers by the nodes that their constants have in the explicit programs."""
    nodes = {}
    for equation, (coefficients, program) in enumerate(zip(explicit, shown, strict=True)):
        before = constant_places(program)
        for node, origin in zip(constant_places(coefficients.program), coefficients.origins, strict=True):
            if origin is not None:
                nodes[equation, before[origin]] = (equation, node)
    return [tuple((nodes[place], multiple) for place, multiple in number) for number in shared]


def unseen_comparison(task: ModellingTask) -> ModelComparison | None:
    """Return a comparison over the held-out trajectories; None when there are none."""
    if not any(trajectory.held_out for trajectory in task.recording.trajectories):
        return None
    return task.compare(task.measurements(task.variables, held_out=True), task.variables)


def _held_out(
    final: Final, unseen: ModelComparison, programs: Sequence[Program], errors: Errors | None = None
) -> HeldOut:
    """Simulate the held-out trajectories from initial states that are fitted to them.

    With the `errors` of the constants there are bands; these programs are the ones shown, then.
    """
    measurements = unseen.estimator.measurements
    fit = fit_starts(unseen, programs)
    if fit is None:
        return HeldOut(tuple(not_simulated(measurements, held_out=True)), tuple(-np.inf for _ in measurements.observed))
    spread = None if errors is None else _carried_bands(final, unseen, fit, errors)
    return HeldOut(
        tuple(simulated(measurements, fit, spread, final.task.variables, held_out=True)),
        tuple(r2_of(measurements, fit, slice(None))),
    )


def _carried_bands(final: Final, comparison: ModelComparison, fit: TrajectoryFit, errors: Errors) -> FloatArray | None:
    """Return the standard errors (O, N) of trajectories that constants were not fitted to; None when they fail.

    One trajectory after another: of dozens of states the sensitivities of all would take more memory than there is.
    """
    free = final.free.fit
    spread, trajectory_bands = scaled_covariance(free, errors), []
    for owner in sorted(set(comparison.estimator.measurements.owners.tolist())):
        estimator, starts = comparison.estimator.of_trajectory(owner, fit)
        near = estimator.fit(free.system, None, 0, starts, free.errors, is_stiff=fit.is_stiff)
        if near is None:
            return None
        trajectory_bands.append(bands(estimator.measurements, near, *spread))
    return np.concatenate(trajectory_bands, axis=1)


def long_run_of(final: Final) -> LongRun:
    """Return what is known of a model along whole trajectories.

    It is chaotic where initial states are of no use for these, errors growing faster than the trajectories do: growth
    has no attractor to stay on. That a model that is, or may be, does not fit whole trajectories says nothing; one that
    cannot be chaotic is tested along them however fast errors grow.
    """
    if final.task.piece >= final.task.longest:
        return LongRun(True, None)
    fit = final.free.fit
    rate = growth_rate(fit)
    growths = (rate, rate - speed_growth(fit))
    may_be = may_be_chaotic(final.seen.estimator.measurements)
    fits = None if may_be and all(_is_exponential(final, growth) for growth in growths) else _fits_in_whole(final)
    if fits:
        return LongRun(fits, None)
    may_be = may_be and not final.by_group
    predictable = max(predictable_rows(fit, final.comparison, growth) for growth in growths)
    if may_be and predictable < final.task.longest:
        if len(final.seen.estimator.measurements.inputs) and predictable < final.task.piece:
            return LongRun(fits, None, None, round(predictable))
        chaos = look_for_chaos(final.seen_fit, rate, final.seen.estimator.tolerance)
        return LongRun(None, chaos, None if chaos is not None else _whole_r2(final))
    fits = None if final.task.is_nearly_clean else fits  # errors of a solver add up
    return LongRun(fits, None, _whole_r2(final) if fits is None else None)


def _whole_r2(final: Final) -> list[float | None] | None:
    """Return R2 (O,) of the equations as they are shown along whole trajectories; None where time is over.

    Without inputs, of very many rows every so-manyth is simulated.
    """
    task = replace(final.task, piece=final.task.longest)
    if task.is_over:
        return None
    measurements = task.measurements(task.variables)
    if not len(measurements.inputs):
        measurements = measurements.strided(-(-measurements.rows // SETTINGS.rows.most))
    comparison = task.compare(measurements, task.variables, is_precise=True, measured_rows=measurements.rows)
    if final.by_group:
        fit = comparison.estimator.fit(final.seen_fit.system, None, SETTINGS.effort.steps)
    else:
        fit = fit_starts(comparison, final.shown)
    if fit is None:
        return None if task.is_over else [-math.inf for _ in measurements.observed]
    return r2_of(measurements, fit, slice(None))


def _is_exponential(final: Final, rate: float) -> bool:
    """Tell whether errors that grow at this rate grow more along a trajectory than a power of time does.

    Without exponential growth those of D linear equations grow like t^(D - 1) at most: over N rows less than N^D times.
    """
    measurements = final.comparison.estimator.measurements
    rows = final.task.longest
    return rate * measurements.step * rows > len(measurements.scales) * math.log(rows)


def _fits_in_whole(final: Final) -> bool | None:
    """Tell whether equations as they are shown describe whole trajectories up to their noise; None: it was not asked.

    Errors of a phase grow in proportion to time, which is fast at first: that tells it from slow chaos. Constants are
    fitted once more, in pieces that grow to whole trajectories, where there are very many rows to every so-manyth. It
    is not asked of a model that does not describe the pieces, nor when the time is over.
    """
    task, programs = final.task, final.shown
    limit, deadline = SETTINGS.inference.excess, final.comparison.estimator.deadline
    if task.piece >= task.longest or not final.comparison.excess(final.free) <= limit:
        return None
    rows, allowed = task.measurements(task.variables).rows, SETTINGS.selection.fitted_sensitivities
    stride = -(-rows // max(allowed // len(task.variables) ** 2, SETTINGS.shooting.piece))
    if stride > 1 and len(final.comparison.estimator.measurements.inputs):
        return None
    while task.piece < task.longest:
        begun = max(task.piece // stride, SETTINGS.shooting.lengths[1])
        task = replace(task, piece=min(task.piece * SETTINGS.shooting.segment_growth, task.longest))
        measurements = task.measurements(task.variables).strided(stride)
        comparison = task.compare(measurements, task.variables, is_precise=True, measured_rows=rows)
        model = comparison.fit_model(programs, lengths=(begun, None))
        if deadline.is_over:
            return None
        if model is None or not comparison.excess(model) <= limit:
            return False
        programs = model.programs
    return True


def _odds(nats: float) -> float:
    """Return the odds of a description that is longer by so many nats, at most one."""
    return math.exp(-max(nats, 0.0))


def _odds_of_data(other: FittedModel, own: FittedModel, equation: int, points: FloatArray) -> float:
    """Return the odds of another model without what makes structures plausible: by misfit and constants (Schwarz 1978).

    An elaboration, whose equation as a sum is the model's own with some values of its constants, has no other odds than
    with it: there are many of them, each of which describes about as much.
    """
    program, contained = other.programs[equation], own.programs[equation]
    expansion = expand_program(program)
    whole = program if expansion is None else expansion.program
    if len(constant_places(whole)) > len(constant_places(contained)) and contains(whole, contained, points):
        return _odds(other.nats - own.nats)
    lengths = [model.nats - math.fsum(map(structure_length, model.programs)) for model in (other, own)]
    return _odds(lengths[0] - lengths[1])


def predictions_of(final: Final, errors: Errors, *, is_near: bool) -> list[Prediction]:
    """Return how far each state can be foretold from other initial states, see `foretell`.

    The odds that the data alone give an alternative are shared by all alternatives of its equation: these were chosen
    from many because they describe the data well (Bonferroni).
    """
    ranking = final.ranking
    own = ranking.selection.model
    rivals = [
        Rival(
            alternative.model.fit.system,
            equation,
            _odds(alternative.model.nats - own.nats),
            _odds_of_data(alternative.model, own, equation, final.visited) / len(alternatives),
        )
        for equation, alternatives in enumerate(ranking.alternatives)
        for alternative in alternatives
    ]
    drawn = draws(final.free.fit.system, scaled_covariance(final.free.fit, errors)[0])
    seen = final.seen.estimator
    return foretell(seen.measurements, final.seen_fit.system, rivals, seen.tolerance, drawn, is_near=is_near)


def refined_equation(
    final: Final, index: int, known: Known, held_out_r2: float | None, prediction: Prediction | None,
    long_run: LongRun,
) -> Refined:  # fmt: skip
    task = final.task
    name, program = task.variables[index], final.shown[index]
    problem = task.dataset.problem(name)
    programs = [group_programs[index] for group_programs in final.by_group] or [program]
    error, mse = grouped_errors_on(problem, programs, task.config.evolution.loss)
    alternatives = _reported_alternatives(final, index, held_out_r2)
    nearest = _no_elaborations(final.ranking.selection.model.programs[index], alternatives)
    rivals = sum(math.exp(-max(alternative.nats, 0.0)) for alternative in alternatives if not alternative.is_shown)
    is_told = not task.is_nearly_clean or rivals <= math.exp(-SETTINGS.inference.exact_nats)
    if prediction is not None and not is_told:
        prediction = replace(prediction, measure_from=_disputed_state(final.ranking, index), is_disputed=True)
    variance = problem.target.standard_deviation**2
    smoothing = task.recording.smoothing[task.recording.states.index(name)]
    measurements = final.seen.estimator.measurements
    noise = float(measurements.noise[index])
    sensor, innovations = final.comparison.errors, None
    if sensor is not None and sensor.shares[index] > 0.0:
        noise, whitened = float(sensor.sigmas[index]), final.seen.estimator.whitened(final.seen_fit.residuals, sensor)
        innovations = _pieces_of(whitened, measurements, index)
    is_interpolated = _is_interpolated(smoothing)
    estimate, is_noise_residual = float(measurements.noise[index]), False
    if smoothing.method == "interpolation" and np.bincount(measurements.owners_of_rows).max() <= 2 * HALF_WIDTHS:
        # Of rows so few that none has all the neighbours that predict it, interpolation hides noise: it takes the least
        # of several estimates. What is rough in the residuals is noise then.
        rough = float(roughness(measurements, final.seen_fit.residuals)[index])
        is_noise_residual = rough > estimate
        estimate = max(estimate, rough)
        noise = max(noise, estimate)
    covariance = _residual_covariance(final, index)
    followed = _followed(final, index)
    baseless = _baseless(final, index, followed)
    evidence = Evidence(
        kind="groups" if final.by_group else "trajectories",
        error=error / problem.target.standard_deviation,
        target_uncertainty=problem.target.uncertainty,
        convergence_threshold=problem.target.convergence_threshold(),
        target_r2=1.0 - mse / variance if variance else None,
        residuals=_pieces_of(final.seen_fit.residuals, measurements, index),
        innovations=innovations,
        covariance=covariance if innovations is None else None,
        solver=final.task.solver,
        parameters=final.fitted[index],
        noise=0.0 if is_interpolated else noise,
        noise_estimate=estimate,
        is_noise_residual=is_noise_residual,
        is_near=measurements.has_smoothed_inputs,
        standard_deviation=_standard_deviation(measurements, index),
        reference=_reference_smoother(smoothing, noise) if innovations is None else None,
        are_errors_summed=final.are_errors_summed,
        has_outliers=smoothing.outliers > 0,
        held_out_r2=held_out_r2,
        is_cross_validated=final.unseen is None,
        null_nats=final.null_nats[index],
        constants=known.written,
        unit_coefficients=[coefficient.constant for coefficient in known.unit_coefficients],
        prediction=None if baseless else prediction,
        unpredicted=f"they follow from '{baseless}', whose equation describes its rows no better than no equation",
        chaos=long_run.chaos,
        fits_whole=_fits(long_run, noise / _standard_deviation(measurements, index), index),
        piece=final.task.piece,
        predictable_rows=long_run.predictable_rows,
        alternative=min((alternative.nats for alternative in nearest), default=None),
        rivals=rivals if task.is_nearly_clean else 0.0,
        rivals_agree=not is_told,
        passes_pole=_passes_pole(final, program),
        distinct_rows=_distinct_rows(measurements, index, {task.dataset.names[one] for one in variables_of(program)}),
        unknown_inputs=_unknown_inputs(final, [index, *followed]),
        held_inputs=_held_inputs(task.recording),
        stopped="the choice of the equations" if task.has_been_stopped else "",
    )
    verdict = judge(evidence)
    member = task.candidates[name].member_of(program)
    origin = final.origin(index, final.ranking.selection.model.programs[index])
    together = final.equations.rounded.together
    return Refined(
        member, program, error, mse, known.written, known.unit_coefficients, alternatives, verdict.grade,
        verdict.reason, verdict.checks, origin, evidence.prediction,
        simple_together=together[index] if together else None,
    )  # fmt: skip


def _disputed_state(ranking: Ranking, index: int) -> dict[str, float]:
    """Return the state beside the measured ones where an equation and its alternatives differ most."""
    comparison, others = ranking.selection.comparison, [one.model for one in ranking.alternatives[index]]
    return comparison.disputed_state(ranking.selection.model, others, index)


def _distinct_rows(measurements: Measurements, index: int, used: Collection[str]) -> int:
    """Return how many rows differ by more than rounding in one state and in the variables `used` by its equation.

    Rows at a point of rest say the same over and over. Where a variable was not measured, all columns count.
    """
    states, inputs = len(measurements.smoothed), measurements.variables[len(measurements.smoothed) :]
    names = [*(measurements.variables[:states][place] for place in measurements.observed), *inputs]
    values = np.concatenate([measurements.measured, measurements.inputs])
    if set(used) <= set(names):
        values = values[[place for place, name in enumerate(names) if place == index or name in used]]
    scales = np.maximum(np.nanstd(values, axis=1), 1e-300)[:, None]
    return len(np.unique(np.nan_to_num(np.round(values / (EXACT_ERROR * scales))) + 0.0, axis=1).T)


def _unknown_inputs(final: Final, equations: Sequence[int]) -> dict[str, float]:
    """Return the share of the variance of a rate that each input makes between its rows, where it is not known.

    The largest of some equations, and of the groups of trajectories with constants of their own. NaN where too few rows
    tell.
    """
    names, shares = final.task.dataset.names, dict[str, float]()
    for name, symbol, variance in final.unknown_inputs:
        column = names.index(symbol) if symbol in names else -1
        using = [one for one in equations if column in variables_of(final.shown[one])]
        if using:
            by = math.nan if variance is None else math.sqrt(variance)
            shares[name] = max(
                _share_of_rate(programs[one], points, column, by) for programs, points in final.by_rows for one in using
            )
    return shares


def _share_of_rate(program: Program, points: FloatArray, column: int, by: float) -> float:
    """Return the share of the variance of a rate that errors of one variable, of this size (`by`), make of it.

    The errors have either sign, and the larger change of the rate counts at each of the points (V, R). The share is of
    the sum of both variances: 1 where a change leads to where the rate has no value, NaN for a size that is not known.
    """
    if not by > 0.0:
        return by
    moved = np.repeat(points[:, :, None], 2, axis=2)
    moved[column] += np.array([-by, by])
    rates = values_of(program, points)
    with np.errstate(all="ignore"):
        changes = np.abs(values_of(program, moved.reshape(len(points), -1)).reshape(-1, 2) - rates[:, None])
        squares = np.maximum(changes[:, 0], changes[:, 1])[np.isfinite(rates)] ** 2
        variance = float(np.var(rates[np.isfinite(rates)])) if np.isfinite(rates).any() else 0.0
    is_finite = np.isfinite(squares)
    if not is_finite.all() or not len(squares):
        return 1.0
    change = float(np.mean(squares))
    return change / (change + variance) if change > 0.0 else 0.0


def _held_inputs(recording: Recording) -> list[str]:
    kinds = zip(recording.inputs, recording.input_kinds, strict=False)
    return [name for name, kind in kinds if kind == "held"]


def _passes_pole(final: Final, program: Program) -> bool:
    """Tell whether the simulation of the model goes from one row to the next through a pole of an equation."""
    points, owners = final.visited, final.seen.estimator.measurements.owners_of_rows
    rows = np.flatnonzero(owners[1:] == owners[:-1])
    return bool(find_poles(program, points[:, rows], points[:, rows + 1]))


def _reference_smoother(smoothing: Smoothing, noise: float) -> ReferenceSmoother | None:
    """Return the smoother with a narrower span than the selected one; None where the state was interpolated.

    `noise` is that of a row of weight 1 by the selected one.
    """
    if smoothing.degree is None or not smoothing.narrower_span:
        return None
    narrower = smoothing.narrower_noise * (noise / smoothing.noise if smoothing.noise > 0.0 else 1.0)
    return ReferenceSmoother(smoothing.narrower_span, smoothing.degree, narrower)


def _no_elaborations(program: Program, alternatives: Sequence[Alternative]) -> list[Alternative]:
    """Return the others that have no more constants than `program`, as it was before its constants were made simple.

    More constants always describe about as well; that is no reason to doubt the equation with fewer, unless they
    describe the data far better.
    """
    most = len(constant_places(program))
    return [
        alternative
        for alternative in alternatives
        if not alternative.is_shown
        and (len(constant_places(alternative.program)) <= most or alternative.nats < -SETTINGS.inference.distinct_nats)
    ]


def _pieces_of(residuals: FloatArray, measurements: Measurements, index: int) -> list[FloatArray]:
    """Return what is left of a state along each piece, where it was measured and counts, as in a row of weight 1."""
    pieces = [slice(first, end) for first, end in measurements.bounds.tolist()]
    residuals = (
        residuals[index]
        if measurements.inverse_variances is None
        else residuals[index] * np.sqrt(measurements.inverse_variances[index])
    )
    parts = [residuals[rows][measurements.weights[index, rows] > 0.0] for rows in pieces]
    return [part for part in parts if len(part)]


def _standard_deviation(measurements: Measurements, index: int) -> float:
    """Return the standard deviation of the measured values of a state, where they count, as in a row of weight 1."""
    counts = measurements.weights[index] > 0.0
    values = measurements.measured[index][counts]
    if not len(values):
        return 1e-300
    weights = np.ones(len(values))
    if measurements.inverse_variances is not None:
        weights = measurements.inverse_variances[index][counts]
    mean = float((weights * values).sum() / weights.sum())
    return max(math.sqrt(float(np.mean(weights * (values - mean) ** 2))), 1e-300)


def _residual_covariance(final: Final, index: int) -> FloatArray | None:
    """Return the covariance of the residuals of a state; None where other rows are simulated than constants are
    fitted to."""
    measurements = final.comparison.estimator.measurements
    if measurements.rows != final.seen.estimator.measurements.rows or final.piece != final.task.piece:
        return None
    return residual_covariance(measurements, final.free.fit, index)


def _is_interpolated(smoothing: Smoothing) -> bool:
    """Tell whether a state was taken to have no noise."""
    return smoothing.method == "interpolation" and smoothing.quantisation is None


def _fitted_to(final: Final, index: int) -> float:
    """Return how many numbers were fitted to the measurements of one state.

    Of few rows that is what the projection on all that can be fitted takes from its residuals, by their covariance:
    what another state does not need follows this one. Of many rows, and where there is no noise, the numbers are shared
    evenly.
    """
    recording, measurements = final.task.recording, final.seen.estimator.measurements
    smoothing = recording.smoothing[recording.states.index(final.task.variables[index])]
    covariance = None if _is_interpolated(smoothing) else _residual_covariance(final, index)
    if covariance is not None:
        return len(covariance) - float(np.trace(covariance))
    return (final.free.fit.system.count + final.seen_fit.starts.size) / len(measurements.observed)


def _followed(final: Final, index: int) -> list[int]:
    """Return the other equations that the simulation of one state follows from, directly or through others."""
    task, recording = final.task, final.task.recording
    owners = {symbol: column for column, symbol in zip(recording.states, recording.state_symbols, strict=True)}
    owners |= dict(zip(recording.velocity_symbols, recording.states, strict=False))
    needed, waiting = {task.variables[index]}, [index]
    while waiting:
        symbols = (task.dataset.names[one] for one in variables_of(final.shown[waiting.pop()]))
        new = {owners[symbol] for symbol in symbols if symbol in owners} - needed
        needed |= new
        waiting += [task.variables.index(name) for name in new if name in task.variables]
    return [place for place, name in enumerate(task.variables) if name in needed and place != index]


def _baseless(final: Final, index: int, followed: Sequence[int]) -> str:
    """Return a state that the predictions of another one follow from, and whose equation is no better than none.

    An equation that stands in for none makes up its simulation, and what follows from it, along what was measured
    alone. "" where there is no such state; equations that were given need no evidence.
    """
    least, given = SETTINGS.inference.chance_nats, final.comparison.fixed
    return next(
        (final.task.variables[one] for one in followed if final.null_nats[one] < least and one not in given), ""
    )


def _fits(long_run: LongRun, noise: float, index: int) -> bool | None:
    """Tell whether the equation of a state describes whole trajectories; None where that was not tested.

    Where pieces are all that is described up to the noise, whole trajectories have an R2 above 0.9 less the noise.
    """
    if long_run.fits is not None or long_run.r2 is None:
        return long_run.fits
    r2 = long_run.r2[index]
    return r2 is None or r2 >= 1.0 - SETTINGS.inference.part - noise * noise


def _null_nats(final: Final, index: int, parameters: float) -> float:
    """Return by how many nats an equation describes the measured state better than no equation does.

    Without an equation the state is constant along each trajectory, or a random walk: the better of both counts. A
    constant rate is compared with a walk that has a drift, since few rows of any smooth curve are about a line.
    Residuals about a constant count as many as are independent; beside the steps of a walk the innovations of
    correlated errors do. Rows count by their weights. Constants are the equation's own, or as many as each state has on
    average, or the `parameters` fitted to this one, if that is more, and with them initial numbers beyond one for each
    trajectory.
    """
    measurements, fit, sensor = final.seen.estimator.measurements, final.seen_fit, final.comparison.errors
    program, is_given = final.shown[index], index in final.comparison.fixed
    squares = deviations = effective = 0.0
    series, times = [], []
    for owner in range(len(measurements.names)):
        rows = (measurements.owners_of_rows == owner) & (measurements.weights[index] > 0.0)
        values, weights = measurements.measured[index][rows], measurements.weights[index][rows]
        if len(values):
            mean = float((weights * values).sum() / weights.sum())
            deviations += float((weights * (values - mean) ** 2).sum())
            squares += float((weights * fit.residuals[index][rows] ** 2).sum())
            effective += float(weights.sum()) ** 2 / float((weights * weights).sum())
            series.append(np.sqrt(weights) * (values - mean))
            times.append(measurements.times[rows])
    steps = squared_steps(series)
    if not (deviations > 0.0 and steps > 0.0):
        return math.inf
    drift = 0
    if not variables_of(program):  # a constant rate is the drift of a random walk
        drift, least = 1, deviations * EXACT_ERROR**2
        squares, steps = max(squares, least), max(squared_steps(series, times), 2.0 * least)
    lengths = final.free.fit.errors.lengths
    rows_of_one = max(float(lengths[index]) if len(lengths) > index else 1.0, 1.0)
    constants = 0.0 if is_given else max(len(constant_places(program)), final.free.fit.system.count / len(final.shown))
    constants += max(fit.starts.size / len(measurements.observed) - len(series), 0.0)
    constants = max(constants, parameters - len(series))
    of_constant = log_bayes_factor(effective / rows_of_one - (len(series) - 1), constants, squares / deviations)
    innovations = squares
    if sensor is not None and sensor.shares[index] > 0.0:
        innovations = float(final.seen.estimator.squared_innovations(fit.residuals, sensor)[index])
        constants += 1.0  # the correlation was fitted as well, and a walk has none
    of_walk = log_bayes_factor(effective - drift - (len(series) - 1), max(constants - drift, 0.0), innovations / steps)
    return min(of_constant, of_walk) - (0.0 if is_given else structure_price(program, len(final.task.dataset.names)))


def _prediction_r2(final: Final, out: HeldOut | None, index: int) -> float | None:
    """Return R2 of a state along trajectories that were held out, or else left out one at a time, if any were."""
    validation = out if out is not None else final.ranking.validated
    return None if validation is None else validation.r2[index]


def _reported_alternatives(final: Final, index: int, held_out_r2: float | None) -> tuple[Alternative, ...]:
    """Return the equation that is shown and what came closest to it, all other equations as they are."""
    ranking = final.ranking
    comparison, best = ranking.selection.comparison, ranking.selection.model
    r2 = r2_of(final.seen.estimator.measurements, final.seen_fit, slice(None))[index]
    origin = final.origin(index, best.programs[index])
    is_crossed = final.unseen is None and ranking.validated is not None
    alternatives = [Alternative(final.shown[index], 0.0, r2, held_out_r2, True, is_crossed, origin)]
    for alternative in ranking.alternatives[index]:
        program, nats = alternative.model.programs[index], alternative.model.nats - best.nats
        r2 = r2_of(comparison.estimator.measurements, alternative.model.fit, slice(None))[index]
        held_out_r2 = None if alternative.validated is None else alternative.validated.r2[index]
        if nats <= SETTINGS.inference.distinct_nats and final.unseen is not None and not final.by_group:
            held_out_r2 = _held_out(final, final.unseen, alternative.model.programs).r2[index]
        is_crossed = alternative.validated is not None
        alternatives.append(
            Alternative(program, nats, r2, held_out_r2, False, is_crossed, final.origin(index, program))
        )
    return tuple(alternatives)
