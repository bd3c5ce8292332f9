"""Comparison of systems: each is fitted to the trajectories, and the shortest description wins (Rissanen 1978).

How it works. A `ModelComparison` has measurements, constraints and one `Score`. It builds an `OdeSystem` from one
program for each equation, fits constants and initial states by multiple shooting, and returns a `FittedModel` with its
nats. `fit_model` fits in stages of growing segments. `fit_from` fits whole pieces, starting from the initial states of
a similar system. Many systems are fitted in threads or on workers; a worker returns a small `FitSummary`, and one
integration here restores the complete fit when it is needed. `narrow_down` is a tournament: many programs with few
steps, then fewer programs with more steps. `calibrate` returns a new comparison whose error model is estimated from the
residuals of a model. The length of a system in one comparison must not be compared with a length in another comparison.

Trajectories decide, and not derivatives: smoothing errors are large and correlated, so a wrong equation often has a
smaller error of the derivative than the true equation. It hardly ever has a smaller misfit to the measured states.

Doubts. A tournament can drop the right program early if its fit needs many steps. Budgets count work and not seconds.
So results are reproducible, but they depend on the constants in the settings.
"""

import math
from bisect import bisect_left, bisect_right, insort
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Final

import numpy as np

from atoll_coordinator.model.batches import BatchFunction, Spread
from atoll_coordinator.model.description_length import least_term_length
from atoll_coordinator.model.least_squares import SETTLED
from atoll_coordinator.model.selection.grouped_rows import GroupedRows
from atoll_coordinator.model.selection.score import FittedModel, Score, SummarizedFit
from atoll_coordinator.model.shooting.composed_system import composed_system
from atoll_coordinator.model.shooting.error_model import ErrorModel
from atoll_coordinator.model.shooting.fit_result import TrajectoryFit
from atoll_coordinator.model.shooting.measurements import TrajectoryMeasurements
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting, fit_in_stages
from atoll_coordinator.model.shooting.points_between import points_in_boxes
from atoll_coordinator.model.shooting.system import OdeSystem, Place, SharedNumber, system_of
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import Program, constant_places, structure
from atoll_core.expression.restrictions import NONE, Restrictions
from atoll_core.expression.template import Composition, EquationTemplate
from atoll_core.wire.values import encode_value

Programs = tuple[Program, ...]
STAGES: Final[tuple[int | None, ...]] = (*SETTINGS.shooting.lengths[:2], None)
"""Segment lengths, in rows, of the successive stages of a fit; None: whole trajectories."""
_REPEATED: Final = 10.0 * SETTLED
"""If the relative difference of two misfits is smaller, the misfits count as equal: fits converge only to this
accuracy."""


@dataclass(frozen=True, eq=False)
class FitStart:
    """The start of a fit: initial states, error model, and stiffness. With groups of trajectories, also a system with
    the constants of each group; with a template, also the values of its parameters."""

    starts: FloatArray
    errors: ErrorModel
    is_stiff: bool
    system: OdeSystem | None = None
    parameters: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class FitPlan:
    """How systems are fitted: in stages of segments of growing `lengths`, or in whole pieces from the start `near`.

    A fit takes at most `steps` steps. A fit from `near` ends when its description cannot become shorter than `limit`
    nats.
    """

    steps: int
    lengths: tuple[int | None, ...] = ()
    near: FitStart | None = None
    limit: float = math.inf


@dataclass(frozen=True, eq=False)
class FitSummary:
    """The numbers that determine a fit: `constants` of all nodes (with groups, also by group), and initial states.

    `length` is the length of the fit's segments (rows; None: whole trajectories). `squares` are mean squares of
    residuals. One integration restores the complete fit from these numbers. States, residuals and normal equations are
    hundreds of times as large, and are not needed for most candidates.
    """

    constants: FloatArray
    by_group: FloatArray | None
    starts: FloatArray
    errors: ErrorModel
    squares: FloatArray
    length: int | None
    is_stiff: bool
    misfit: float
    nats: float


PlannedFit = tuple[FitPlan, Programs]
"""A plan, and the programs of the system to be fitted."""
FitOutcome = tuple[FitSummary | None, int]
"""The summary of a fit, and the work of this fit. The summary is None if the system could not be fitted."""
_FITS_OF_A_BATCH: Final = 12
"""Most fits of a batch: one fit takes from a millisecond to some seconds."""


@dataclass(frozen=True, eq=False)
class PrefetchedModels:
    """Models that were fitted in advance, with other programs for one equation; and the work of these fits."""

    models: Sequence[FittedModel]
    work: int


@dataclass(frozen=True, eq=False)
class Constraints:
    """`restrictions` of equations by index; `groups` of trajectories that may have constants of their own; the
    `template` of the equations, and the values (P,) of its parameters with which fits start."""

    restrictions: Mapping[int, Restrictions] = field(default_factory=dict)
    groups: GroupedRows | None = None
    template: EquationTemplate = field(default_factory=EquationTemplate)
    parameters: FloatArray = field(default_factory=lambda: np.zeros(0))


def differ(first: FloatArray, second: FloatArray, share: float = SETTINGS.common.negligible) -> bool:
    """Tell whether values (R,) of two equations differ by more than this share of their standard deviation."""
    with np.errstate(all="ignore"):
        difference = float(np.sqrt(np.mean((first - second) ** 2)))
        size = SETTINGS.common.negligible * float(np.sqrt(np.mean(second**2)))  # a constant has no standard deviation
        return not difference <= share * max(float(np.std(second)), size)


def _replace_program(near: FittedModel, equation: int, programs: Iterable[Program]) -> list[Programs]:
    """Return systems like `near`, each with one of these programs as one of the equations."""
    return [(*near.programs[:equation], program, *near.programs[equation + 1 :]) for program in programs]


def _total_work(outcomes: Iterable[FitOutcome | None]) -> int:
    return sum(outcome[1] for outcome in outcomes if outcome is not None)


@dataclass(frozen=True, eq=False)
class ComparisonParts:
    """The parts of a `ModelComparison` that are sent to workers; `roughness`, `rows` and `errors` belong to its
    score."""

    measurements: TrajectoryMeasurements
    tolerance: float
    measured_rows: int
    names: tuple[str, ...]
    fixed: frozenset[int]
    leading: tuple[Program, ...]
    constraints: Constraints
    roughness: FloatArray
    rows: FloatArray
    errors: ErrorModel | None


@dataclass(frozen=True, eq=False)
class ModelComparison:
    """Fits systems to the same measurements and compares them by one score.

    A comparison never changes its score: `calibrate` returns another comparison, without fitted models.

    Attributes:
        estimator: fits systems to the measurements.
        names: the variables of the programs.
        fixed: equations, by index, whose form is given, so that nothing is searched.
        leading: for order 2, the equations of the positions, which come before the other equations.
        spread: fits systems in threads or on workers; by default one after another.
        constraints: restrictions of the equations.
        calibration: the score whose errors were estimated from the residuals of an earlier model; None: the score uses
            the smoother's noise.
        fitted_models: the best model of each program that was fitted for an equation, by (equation, structure).
    """

    estimator: MultipleShooting
    names: tuple[str, ...]
    fixed: frozenset[int] = frozenset()
    leading: tuple[Program, ...] = ()
    spread: Spread = field(default_factory=Spread)
    constraints: Constraints = field(default_factory=Constraints)
    calibration: Score | None = None
    fitted_models: dict[tuple[int, bytes], FittedModel] = field(default_factory=dict, init=False)

    @cached_property
    def score(self) -> Score:
        """The score by which systems are compared."""
        count = 1 if self.groups is None else self.groups.count
        return self.calibration or Score.from_smoother(self.estimator, len(self.leading), self.fixed, count)

    @property
    def template(self) -> EquationTemplate:
        """The template of the equations; without sides, whole right-hand sides are searched."""
        return self.constraints.template

    @property
    def is_complete(self) -> bool:
        """Whether the equations have no unknown part of an equation that is not compared here."""
        template = self.template
        return all(
            template.unknowns[place].home in template.equations
            for name in template.equations
            for place in template.unknowns_in(name)
        )

    @property
    def held(self) -> frozenset[int]:
        """The equations, by index, whose constants are given, too, and not fitted."""
        names = enumerate(self.template.equations)
        return frozenset(self.fixed) - {index for index, name in names if name in self.template.sides}

    @property
    def groups(self) -> GroupedRows | None:
        """Rows by group, where groups of trajectories may have constants of their own."""
        return self.constraints.groups

    def calibrate(self, model: FittedModel) -> tuple["ModelComparison", FittedModel]:
        """Return a comparison whose error model is estimated from the residuals of `model`, and `model` fitted with
        this error model."""
        score, fit = self.score.calibrate(model.fit)
        comparison = replace(self, calibration=score)
        return comparison, comparison.score_fit(fit)

    def fit_all(
        self, systems: Sequence[Sequence[Program]], steps: int = SETTINGS.effort.steps,
        lengths: Sequence[int | None] = STAGES,
    ) -> list[FittedModel]:  # fmt: skip
        """Return the models of systems by `fit_model`, the shortest description first; failed fits are left out.

        After the deadline no more systems are fitted.
        """
        return self._fit_systems(FitPlan(steps, tuple(lengths)), list(map(tuple, systems)))

    def _fit_systems(self, plan: FitPlan, systems: Sequence[Programs], until: float = math.inf) -> list[FittedModel]:
        """Return the models of systems, the shortest description first; failed fits are left out.

        Systems are fitted in order until the estimator's work reaches `until`, or until the deadline. Workers may fit
        more systems than this limit allows; these results and their work are then dropped.
        """
        bounded = SETTINGS.effort.kept if until < math.inf else max(len(systems), 1)
        ahead = self._fit_on_workers(plan, systems) if self.spread.is_shared and len(systems) > 1 else None
        models: list[FittedModel] = []
        for first in range(0, len(systems), bounded):
            if first and self.estimator.work >= until:
                break
            part = systems[first : first + bounded]
            if ahead is None:
                fits = self.spread.map_threads(partial(self.fit_by_plan, plan), part)
                models += [model for model in fits if model is not None]
            else:
                outcomes = ahead[first : first + bounded]
                self.estimator.add_work(_total_work(outcomes))
                models += self._models_from_summaries(plan, part, outcomes)
        return sorted(models, key=lambda model: model.nats)

    def fit_by_plan(self, plan: FitPlan, programs: Programs) -> FittedModel | None:
        """Return the fitted system. None if it cannot be simulated, if it violates restrictions, or if the time is
        over."""
        if self.estimator.deadline.is_over:
            return None
        if plan.near is None:
            model = self.fit_model(programs, plan.steps, plan.lengths)
        else:
            model = self._fit_from_start(plan.near, programs, plan.steps, limit=plan.limit)
        return model if model is not None and math.isfinite(model.nats) else None

    def _fit_on_workers(self, plan: FitPlan, systems: Sequence[Programs]) -> list[FitOutcome | None]:
        """Return the outcomes of fits on workers; None for fits that the deadline stopped."""
        fits = [(plan, programs) for programs in systems]
        outcomes = self.spread.map_workers(FITS, self.encoded_parts, fits, _FITS_OF_A_BATCH)
        self.spread.note(sum(outcome is not None and outcome[0] is not None for outcome in outcomes))
        return outcomes

    def _models_from_summaries(
        self, plan: FitPlan, systems: Sequence[Programs], outcomes: Sequence[FitOutcome | None]
    ) -> list[FittedModel]:
        """Return the models of systems that workers have fitted."""
        pairs = zip(systems, outcomes, strict=True)
        return [
            self.model_from_summary(plan, programs, outcome[0]) for programs, outcome in pairs if outcome and outcome[0]
        ]

    def model_from_summary(self, plan: FitPlan, programs: Programs, summary: FitSummary) -> FittedModel:
        """Return the model of a system that a worker has fitted."""
        admitted = self.admissible_programs(programs)
        assert admitted is not None, "a fitted system meets the restrictions"

        def fitted_system() -> OdeSystem:
            near = None if plan.near is None else plan.near.system
            system = replace(self.system(admitted, (), near), constants=summary.constants)
            if system.sharing is not None and summary.by_group is not None:
                system = replace(system, sharing=replace(system.sharing, constants=summary.by_group))
            return system

        def complete() -> TrajectoryFit:
            stiff = summary.is_stiff
            return self.estimator.complete(
                fitted_system(), summary.length, summary.starts, summary.errors, is_stiff=stiff
            )

        if not self.template.sides:
            ends = np.cumsum([len(program) for program in (*self.leading, *admitted)])
            parts = np.split(summary.constants, ends[:-1])[len(self.leading) :]
            fitted = tuple(replace(one, constants=part) for one, part in zip(admitted, parts, strict=True))
        else:
            fitted = fitted_system().searched(len(self.leading))
        return FittedModel(fitted, SummarizedFit(summary.squares, complete), summary.misfit, summary.nats)

    def fit_and_summarize(self, planned: PlannedFit) -> FitOutcome:
        """Fit a system and return its summary and work, as a worker sends them."""
        plan, before = planned[0], self.estimator.work_of_thread
        model = self.fit_by_plan(*planned)
        return None if model is None else self.summarize(plan, model), self.estimator.work_of_thread - before

    def summarize(self, plan: FitPlan, model: FittedModel) -> FitSummary:
        """Return the summary of a model, as a worker sends it."""
        fit, sharing = model.fit, model.fit.system.sharing
        is_hidden = bool(self.estimator.measurements.hidden)
        in_whole = plan.near is not None or self.score.errors is not None or is_hidden
        return FitSummary(
            fit.system.constants, None if sharing is None else sharing.constants, fit.starts, fit.errors, fit.squares,
            None if in_whole else plan.lengths[-1], fit.is_stiff, model.misfit, model.nats,
        )  # fmt: skip

    @property
    def parts(self) -> ComparisonParts:
        """The parts of this comparison, with its calibration."""
        estimator = self.estimator
        return ComparisonParts(
            estimator.measurements, estimator.tolerance, estimator.measured_rows, self.names, self.fixed, self.leading,
            self.constraints, self.score.roughness, self.score.rows, self.score.errors,
        )  # fmt: skip

    @cached_property
    def encoded_parts(self) -> bytes:
        """The encoded parts of this comparison."""
        return encode_value(self.parts)

    @classmethod
    def from_parts(cls, parts: ComparisonParts) -> "ModelComparison":
        """Return the comparison with these parts. It must not be calibrated."""
        estimator = MultipleShooting(parts.measurements, parts.tolerance, measured_rows=parts.measured_rows)
        comparison = cls(estimator, parts.names, parts.fixed, parts.leading, constraints=parts.constraints)
        score = replace(comparison.score, roughness=parts.roughness, rows=parts.rows, errors=parts.errors)
        return replace(comparison, calibration=score)

    def restrictions(self, equation: int) -> Restrictions:
        """Return the restrictions of an equation; a known equation has none."""
        return NONE if equation in self.fixed else self.constraints.restrictions.get(equation, NONE)

    def admissible_programs(self, programs: Sequence[Program]) -> list[Program] | None:
        """Return `programs` in a form that meets the restrictions; None if one of them cannot meet them."""
        if not self.constraints.restrictions:
            return list(programs)
        admissible_programs = [self.restrictions(index).admitted(program) for index, program in enumerate(programs)]
        return (
            None
            if any(program is None for program in admissible_programs)
            else [program for program in admissible_programs if program is not None]
        )

    def system(
        self, programs: Sequence[Program], fixed_nodes: Sequence[Iterable[int]] = (), near: OdeSystem | None = None,
        shared: Collection[SharedNumber] = (), parameters: FloatArray | None = None,
    ) -> OdeSystem:  # fmt: skip
        """Return the system of `programs`.

        Args:
            programs: one for each equation. With a template, they are its unknown parts.
            fixed_nodes: for each program, the nodes whose constants are not fitted. If they are given, the parameters
                of a template are not fitted either.
            near: a similar system, used if groups of trajectories have their own constants. If an equation is also in
                `near`, its fit starts with the constants that each group has in `near`. The constants of other
                equations are first fitted to the rows of each group.
            shared: fitted numbers that are common to all groups, or to several constants.
            parameters: values of the parameters of a template; None: the values with which fits start.
        """
        fixed = [
            set(constant_places(program)) if index in self.held else set(fixed_nodes[index]) if fixed_nodes else set()
            for index, program in enumerate(programs)
        ]
        if self.template.sides:
            values = self.constraints.parameters if parameters is None else parameters
            composition = self.template.compose(programs, values)
            return self._composed_system(composition, fixed, is_fixed=bool(fixed_nodes))
        none: list[set[int]] = [set() for _ in self.leading]
        variables = self.estimator.measurements.variables
        system = system_of([*self.leading, *programs], self.names, variables, [*none, *fixed])
        lower, upper = self._ranges(programs, fixed)
        constants = system.constants[None]
        if self.groups is not None:
            constants = self.groups.constants(system, len(self.leading), fixed, near)
        if self.groups is not None or shared:
            system = system.sharing_numbers(constants, shared, len(self.leading))
        if system.sharing is not None and lower is not None and upper is not None:
            lower, upper = system.sharing.ranges(lower, upper)
        return replace(system, lower=lower, upper=upper)

    def _composed_system(
        self, composition: Composition, fixed: Sequence[Collection[int]], *, is_fixed: bool
    ) -> OdeSystem:
        """Return the system of equations that were composed with the template.

        `fixed` are the nodes of the searched programs whose constants are not fitted; `is_fixed`: no parameter is
        fitted.
        """
        template, bounds = self.template, dict[Place, tuple[float, float]]()
        for index, (slot, held) in enumerate(zip(composition.slots, fixed, strict=False)):
            restrictions = self.restrictions(index)
            if restrictions.bounds is None or template.is_given(template.equations[index]):
                continue
            nodes = [node for node in constant_places(slot) if node not in held]
            for node, *ends in zip(nodes, *restrictions.ranges(slot, held).tolist(), strict=True):
                bounds |= dict.fromkeys(composition.places[index].get(node, ()), (ends[0], ends[1]))
        variables = self.estimator.measurements.variables
        return composed_system(
            template, composition, self.names, variables, self.leading, fixed, bounds, are_parameters_fixed=is_fixed
        )

    def equations_of(self, model: FittedModel) -> tuple[Program, ...]:
        """Return the whole right-hand sides of a model; without a template, these are its programs."""
        if not self.template.sides:
            return model.programs
        return model.fit.system.programs[len(self.leading) :][: len(model.programs)]

    def places(self, system: OdeSystem) -> list[Place]:
        """Return equation and node of each fitted constant of a system of this comparison."""
        return system.fitted_constants(len(self.leading))

    def _ranges(
        self, programs: Sequence[Program], fixed: Sequence[Collection[int]]
    ) -> tuple[FloatArray | None, FloatArray | None]:
        """Return bounds (P,) on the fitted constants; None without bounds."""
        restrictions = [self.restrictions(index) for index in range(len(programs))]
        if all(one.bounds is None for one in restrictions):
            return None, None
        triples = zip(restrictions, programs, fixed, strict=True)
        lower, upper = np.concatenate([one.ranges(program, held) for one, program, held in triples], axis=1)
        return lower, upper

    def fit_model(
        self,
        programs: Sequence[Program],
        steps: int = SETTINGS.effort.steps,
        lengths: Sequence[int | None] = STAGES,
    ) -> FittedModel | None:
        """Return the system of `programs`, fitted in stages; None if it cannot be simulated or violates
        restrictions."""
        admitted = self.admissible_programs(programs)
        if admitted is None:
            return None
        if self.estimator.measurements.hidden:  # short segments would need unknown initial values
            lengths = (None,)
        fit = fit_in_stages(self.estimator, self.system(admitted), lengths, steps)
        if fit is not None and self.score.errors is not None:
            fit = self.score.refit_with_errors(fit, self.score.errors)
        return None if fit is None else self._if_shaped(self.score_fit(fit))

    def fit_from(
        self, near: FittedModel, programs: Sequence[Program], steps: int = SETTINGS.effort.steps,
        shared: Collection[SharedNumber] = (),
    ) -> FittedModel | None:  # fmt: skip
        """Return the system of `programs`, fitted from the initial states of `near`.

        None if it cannot be simulated or violates restrictions.
        """
        return self._fit_from_start(self._start_of(near), programs, steps, shared)

    def _start_of(self, near: FittedModel) -> FitStart:
        """Return the start of fits of systems that are similar to `near`."""
        fit = near.fit
        system = None if self.groups is None else fit.system
        return FitStart(fit.starts, fit.errors, fit.is_stiff, system, fit.system.parameter_values)

    def _fit_from_start(
        self, near: FitStart, programs: Sequence[Program], steps: int, shared: Collection[SharedNumber] = (),
        limit: float = math.inf,
    ) -> FittedModel | None:  # fmt: skip
        admitted = self.admissible_programs(programs)
        if admitted is None:
            return None
        system = self.system(admitted, near=near.system, shared=shared, parameters=near.parameters)
        most = self.score.misfit_limit(system, limit) if limit < math.inf else None
        fit = self.estimator.fit(system, None, steps, near.starts, near.errors, is_stiff=near.is_stiff, limit=most)
        return None if fit is None else self._if_shaped(self.score_fit(fit))

    def _if_shaped(self, model: FittedModel) -> FittedModel | None:
        """Return the model; None if one of its programs does not have its demanded shapes."""
        if not self.constraints.restrictions:
            return model
        pairs = enumerate(model.programs)
        return model if all(self.restrictions(index).has_shapes(program) for index, program in pairs) else None

    def fit_replacement(self, near: FittedModel, equation: int, program: Program, steps: int) -> FittedModel | None:
        """Return `near` with another program for one equation, see `fit_from`."""
        return self.fit_from(near, _replace_program(near, equation, [program])[0], steps)

    def fit_near(self, near: FittedModel, parameters: FloatArray, steps: int) -> FittedModel | None:
        """Return `near` fitted from other values of the template's parameters; None if it cannot be simulated."""
        return self._fit_from_start(replace(self._start_of(near), parameters=parameters), near.programs, steps)

    def narrow_down(
        self, near: FittedModel, equation: int, programs: Iterable[Program], rounds: Sequence[tuple[int, int]],
        until: float = math.inf,
    ) -> list[FittedModel]:  # fmt: skip
        """Return the models with the best `programs` for one equation.

        The programs are fitted in `rounds`; each round has a number of steps and the number of programs that are kept
        for the next round. If several programs are equivalent, only the program with the shortest description is kept,
        see `distinct_models`. When the estimator's work has reached `until`, at most one more block of programs is
        fitted. Fits that cannot become about as short as `near` do not converge, see `_limit_of`.
        """
        models: list[FittedModel] = []
        waiting = list(programs)
        beginning = self._start_of(near) if waiting else None
        for steps, kept in rounds:
            plan = FitPlan(steps, near=beginning, limit=self._limit_of(near))
            models = self._fit_systems(plan, _replace_program(near, equation, waiting), until)
            models = self.distinct_models(models, equation)[:kept]
            waiting = [model.programs[equation] for model in models]
        return self._remember(equation, models)

    def _limit_of(self, near: FittedModel) -> float:
        """Return the longest description, in nats, with which a system in the place of `near` is of use. If it is
        longer than `near` by more than the cheapest term, no search goes on from it."""
        return near.nats + least_term_length(self.score.constant_nats)

    def prefetch_models(
        self, near: FittedModel, lists: Mapping[int, Sequence[Program]], rounds: Sequence[tuple[int, int]]
    ) -> dict[int, PrefetchedModels]:
        """Return the results of `narrow_down` for several equations. They are valid as long as `near` is the best
        model.

        Workers fit the programs for all equations at the same time. Without workers, or for a single equation, the
        result is empty. The work is not counted until `accept_prefetched`.
        """
        if len(lists) < 2 or not self.spread.is_shared:
            return {}
        prefetched = {equation: PrefetchedModels([], 0) for equation in lists}
        waiting, beginning = dict(lists), self._start_of(near)
        for steps, kept in rounds:
            plan = FitPlan(steps, near=beginning, limit=self._limit_of(near))
            systems = {equation: _replace_program(near, equation, programs) for equation, programs in waiting.items()}
            outcomes_by_system = iter(self._fit_on_workers(plan, [one for part in systems.values() for one in part]))
            for equation, part in systems.items():
                outcomes = [next(outcomes_by_system) for _ in part]
                models = sorted(self._models_from_summaries(plan, part, outcomes), key=lambda model: model.nats)
                models = self.distinct_models(models, equation)[:kept]
                prefetched[equation] = PrefetchedModels(models, prefetched[equation].work + _total_work(outcomes))
                waiting[equation] = [model.programs[equation] for model in models]
        return prefetched

    def accept_prefetched(self, equation: int, prefetched: PrefetchedModels) -> list[FittedModel]:
        """Return the models that were prefetched, and count their work as `narrow_down` does."""
        self.estimator.add_work(prefetched.work)
        return self._remember(equation, prefetched.models)

    def score_fit(self, fit: TrajectoryFit) -> FittedModel:
        """Return the model of a fit, with its misfit and nats by the score."""
        self.spread.note(1)
        return self.score.score_fit(fit)

    def _remember(self, equation: int, models: Sequence[FittedModel]) -> list[FittedModel]:
        for model in models:
            key = (equation, structure(model.programs[equation]))
            known = self.fitted_models.get(key)
            if known is None or model.nats < known.nats:
                self.fitted_models[key] = model
        return list(models)

    def distinct_models(self, models: Iterable[FittedModel], equation: int) -> list[FittedModel]:
        """Return the `models` (sorted by nats), but drop each model whose `equation` is equivalent to the equation of
        an earlier model.

        Equations are equivalent if their misfits are equal and if they agree away from the measured curves. Equal
        misfits alone are not enough: all equations that agree along the curves have the same integration errors.
        """
        kept: list[FittedModel] = []
        misfits: list[tuple[float, int]] = []
        for model in models:
            misfit = model.misfit
            reach = 2.0 * _REPEATED * (1.0 + abs(misfit))  # no other misfit is close enough
            near = misfits[bisect_left(misfits, (misfit - reach,)) : bisect_right(misfits, (misfit + reach, len(kept)))]
            if all(
                abs(misfit - other) > _REPEATED * (1.0 + abs(other))
                or self.differ_off_trajectories(model, kept[place], equation)
                for other, place in near
            ):
                insort(misfits, (misfit, len(kept)))
                kept.append(model)
        return kept

    def differ_off_trajectories(self, model: FittedModel, other: FittedModel, equation: int) -> bool:
        """Tell whether the values of an equation in two models differ away from the measured curves, by more than a
        limit.

        If there is no noise, the limit is a relative difference of a thousandth. If there is noise, the limit is the
        smallest difference that matters for predictions.
        """
        first, second = (values_of(one.programs[equation], self._points_off_trajectories) for one in (model, other))
        either = np.isfinite(first) | np.isfinite(second)
        share = math.sqrt(SETTINGS.inference.part) if self.score.is_noisy.any() else SETTINGS.common.negligible
        return bool(either.any()) and differ(first[either], second[either], share)

    def disputed_state(self, model: FittedModel, others: Sequence[FittedModel], equation: int) -> dict[str, float]:
        """Return a state away from the measured curves, the value of each variable by name. At this state, one equation
        of `model` differs most from the same equation of the `others`.

        The difference from each other model is weighted by the odds of the other model against `model`.
        """
        own = values_of(model.programs[equation], self._points_off_trajectories)
        differences = np.zeros_like(own)
        for other in others:
            odds = math.exp(-max(other.nats - model.nats, 0.0))
            differences += odds * np.nan_to_num(
                np.abs(values_of(other.programs[equation], self._points_off_trajectories) - own), posinf=0.0
            )
        place, states = int(np.argmax(differences)), len(self.estimator.measurements.smoothed)
        return {
            name: float(value)
            for name, value in zip(self.names, self._points_off_trajectories[:, place], strict=True)
            if name in self.estimator.measurements.variables[:states]
        }

    @cached_property
    def _points_off_trajectories(self) -> FloatArray:
        """Points (V, G) away from the measured curves; G is 0 if groups have their own constants."""
        measurements = self.estimator.measurements
        points = np.concatenate([measurements.smoothed, measurements.inputs])
        moved = len(points if measurements.has_smoothed_inputs else measurements.smoothed)
        points_off = points_in_boxes(points, moved).T if self.groups is None else points[:, :0]
        return np.ascontiguousarray(points_off[[measurements.variables.index(name) for name in self.names]])


FITS: Final[BatchFunction[ModelComparison, PlannedFit, FitOutcome]] = BatchFunction(
    "fits", ComparisonParts, PlannedFit, FitOutcome, ModelComparison.fit_and_summarize, ModelComparison.from_parts
)
"""Systems fitted to the measurements of a comparison."""
