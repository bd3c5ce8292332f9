"""Which equations together describe the measured states in the fewest nats (Rissanen 1978), trajectories simulated.

By derivative error a wrong equation often beats the true one, because smoothing errors are large and coloured; by the
misfit of simulated trajectories to the raw states hardly ever.
"""

import math
from bisect import bisect_left, bisect_right, insort
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Final

import numpy as np

from atoll_coordinator.model.batches import BatchFunction, Spread
from atoll_coordinator.model.least_squares import SETTLED
from atoll_coordinator.model.selection.grouped_rows import GroupedRows
from atoll_coordinator.model.selection.score import FittedModel, Score, SummarizedFit
from atoll_coordinator.model.shooting.error_model import ErrorModel
from atoll_coordinator.model.shooting.measurements import Measurements
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting, fit_in_stages
from atoll_coordinator.model.shooting.points_between import points_beside
from atoll_coordinator.model.shooting.system import Place, SharedNumber, System, system_of
from atoll_coordinator.model.shooting.trajectory_fit import TrajectoryFit
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import Program, constant_places, structure
from atoll_core.expression.restrictions import NONE, Restrictions
from atoll_core.wire.values import encode_value

Programs = tuple[Program, ...]
STAGES: Final[tuple[int | None, ...]] = (*SETTINGS.shooting.lengths[:2], None)
"""Rows of the segments that a system is fitted to, one after another; None: whole trajectories."""
_REPEATED: Final = 10.0 * SETTLED
"""Misfits that differ by less, relative to their size, are of the same function in other words: fits settle so far."""


@dataclass(frozen=True, eq=False)
class Beginning:
    """Where a fit begins: initial states, errors, whether it is stiff; with groups, the system whose constants are."""

    starts: FloatArray
    errors: ErrorModel
    is_stiff: bool
    system: System | None = None


@dataclass(frozen=True, eq=False)
class FitOrder:
    """How systems are to be fitted: in stages of growing `lengths`, or in whole from a beginning `near`.

    A fit takes at most `steps` steps.
    """

    steps: int
    lengths: tuple[int | None, ...] = ()
    near: Beginning | None = None


@dataclass(frozen=True, eq=False)
class FitSummary:
    """The numbers of a fit: `constants` of all nodes, by group if there are any, and the rest that decides it.

    `length` is the length of its segments (rows; None: whole trajectories); `squares` are mean squares of residuals.
    One integration makes the whole fit of these again: states, residuals and normal equations are hundreds of times as
    large, and most candidates do not need them.
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


OrderedFit = tuple[FitOrder, Programs]
"""A system to be fitted."""
FitOutcome = tuple[FitSummary | None, int]
"""The fit of a system, None if it could not be fitted, and its work."""
_FITS_OF_A_BATCH: Final = 12
"""Most fits of a batch: one takes from a millisecond to some seconds."""


@dataclass(frozen=True, eq=False)
class Foreseen:
    """The models of one equation's programs, all other equations as they are, and the work that they took."""

    models: Sequence[FittedModel]
    work: int


@dataclass(frozen=True, eq=False)
class Constraints:
    """`restrictions` of equations by index; `groups` of trajectories that may have constants of their own."""

    restrictions: Mapping[int, Restrictions] = field(default_factory=dict)
    groups: GroupedRows | None = None


def differ(first: FloatArray, second: FloatArray, share: float = SETTINGS.common.negligible) -> bool:
    """Tell whether values (R,) of two equations differ by more than this share of their standard deviation."""
    with np.errstate(all="ignore"):
        difference = float(np.sqrt(np.mean((first - second) ** 2)))
        size = SETTINGS.common.negligible * float(np.sqrt(np.mean(second**2)))  # a constant has no standard deviation
        return not difference <= share * max(float(np.std(second)), size)


def _exchanged(near: FittedModel, equation: int, programs: Iterable[Program]) -> list[Programs]:
    """Return the systems of `near` with each of these programs for one equation."""
    return [(*near.programs[:equation], program, *near.programs[equation + 1 :]) for program in programs]


def _work(outcomes: Iterable[FitOutcome | None]) -> int:
    return sum(outcome[1] for outcome in outcomes if outcome is not None)


@dataclass(frozen=True, eq=False)
class ComparisonParts:
    """The parts of a `ModelComparison` that travel; `roughness`, `rows` and `errors` are of its score."""

    measurements: Measurements
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

    The score never changes: a calibrated comparison is another one, in which nothing was tried yet.

    Attributes:
        estimator: fits systems to the measurements.
        names: the variables of the programs.
        fixed: equations, by index, whose constants are given.
        leading: with order 2 the equations of the positions, which come before the equations that are sought.
        spread: lets threads or workers fit systems; one after another unless given.
        constraints: restrictions of the equations.
        calibration: the score by earlier residuals; None: the score by the smoother's noise.
        tried: the best model of each program that was fitted for an equation, by (equation, structure).
    """

    estimator: MultipleShooting
    names: tuple[str, ...]
    fixed: frozenset[int] = frozenset()
    leading: tuple[Program, ...] = ()
    spread: Spread = field(default_factory=Spread)
    constraints: Constraints = field(default_factory=Constraints)
    calibration: Score | None = None
    tried: dict[tuple[int, bytes], FittedModel] = field(default_factory=dict, init=False)

    @cached_property
    def score(self) -> Score:
        """The score by which systems are compared."""
        count = 1 if self.groups is None else self.groups.count
        return self.calibration or Score.of_smoother(self.estimator, len(self.leading), self.fixed, count)

    @property
    def groups(self) -> GroupedRows | None:
        """Rows by group, where groups of trajectories may have constants of their own."""
        return self.constraints.groups

    def calibrated(self, model: FittedModel) -> tuple["ModelComparison", FittedModel]:
        """Return the comparison by the errors that the residuals of a model show, and the model fitted by these."""
        score, fit = self.score.calibrated(model.fit)
        comparison = replace(self, calibration=score)
        return comparison, comparison.measure(fit)

    def fit_all(
        self, systems: Sequence[Sequence[Program]], steps: int = SETTINGS.effort.steps,
        lengths: Sequence[int | None] = STAGES,
    ) -> list[FittedModel]:  # fmt: skip
        """Return the models of systems by `fit_model`, the shortest description first; without failed fits.

        After the deadline no more are fitted.
        """
        return self._fitted(FitOrder(steps, tuple(lengths)), list(map(tuple, systems)))

    def _fitted(self, order: FitOrder, systems: Sequence[Programs], until: float = math.inf) -> list[FittedModel]:
        """Return the models of systems, the shortest description first; without failed fits.

        Systems are fitted in order as long as the estimator's work is less than `until`, none after the deadline. With
        other workers, more may be fitted than count: the others are dropped, and so is their work.
        """
        bounded = SETTINGS.effort.kept if until < math.inf else max(len(systems), 1)
        ahead = self._fitted_elsewhere(order, systems) if self.spread.is_shared and len(systems) > 1 else None
        models: list[FittedModel] = []
        for first in range(0, len(systems), bounded):
            if first and self.estimator.work >= until:
                break
            part = systems[first : first + bounded]
            if ahead is None:
                fits = self.spread.here(partial(self.fit_ordered, order), part)
                models += [model for model in fits if model is not None]
            else:
                outcomes = ahead[first : first + bounded]
                self.estimator.count(_work(outcomes))
                models += self._models(order, part, outcomes)
        return sorted(models, key=lambda model: model.nats)

    def fit_ordered(self, order: FitOrder, programs: Programs) -> FittedModel | None:
        """Return the fitted system, None where it cannot be simulated or may not stand, or time is over."""
        if self.estimator.deadline.is_over:
            return None
        if order.near is None:
            model = self.fit_model(programs, order.steps, order.lengths)
        else:
            model = self._fit_from(order.near, programs, order.steps)
        return model if model is not None and math.isfinite(model.nats) else None

    def _fitted_elsewhere(self, order: FitOrder, systems: Sequence[Programs]) -> list[FitOutcome | None]:
        """Return the fits of systems, by other workers; None for fits that the deadline stopped."""
        fits = [(order, programs) for programs in systems]
        outcomes = self.spread.share(FITS, self.encoded, fits, _FITS_OF_A_BATCH)
        self.spread.note(sum(outcome is not None and outcome[0] is not None for outcome in outcomes))
        return outcomes

    def _models(
        self, order: FitOrder, systems: Sequence[Programs], outcomes: Sequence[FitOutcome | None]
    ) -> list[FittedModel]:
        """Return the models of systems that were fitted elsewhere."""
        pairs = zip(systems, outcomes, strict=True)
        return [self.summarized(order, programs, made[0]) for programs, made in pairs if made and made[0]]

    def summarized(self, order: FitOrder, programs: Programs, summary: FitSummary) -> FittedModel:
        """Return the model of a system that was fitted elsewhere."""
        admitted = self.admitted(programs)
        assert admitted is not None, "what was fitted may stand"
        ends = np.cumsum([len(program) for program in (*self.leading, *admitted)])
        parts = np.split(summary.constants, ends[:-1])[len(self.leading) :]

        def complete() -> TrajectoryFit:
            near = None if order.near is None else order.near.system
            system = replace(self.system(admitted, (), near), constants=summary.constants)
            if system.sharing is not None and summary.by_group is not None:
                system = replace(system, sharing=replace(system.sharing, constants=summary.by_group))
            stiff = summary.is_stiff
            return self.estimator.complete(system, summary.length, summary.starts, summary.errors, is_stiff=stiff)

        fitted = tuple(replace(one, constants=part) for one, part in zip(admitted, parts, strict=True))
        return FittedModel(fitted, SummarizedFit(summary.squares, complete), summary.misfit, summary.nats)

    def outcome(self, ordered: OrderedFit) -> FitOutcome:
        """Return the summary of a fit, as it is sent."""
        order, before = ordered[0], self.estimator.counted
        model = self.fit_ordered(*ordered)
        return None if model is None else self.summary(order, model), self.estimator.counted - before

    def summary(self, order: FitOrder, model: FittedModel) -> FitSummary:
        """Return the summary, as it is sent, of the model of a system."""
        fit, sharing = model.fit, model.fit.system.sharing
        in_whole = order.near is not None or self.score.errors is not None
        return FitSummary(
            fit.system.constants, None if sharing is None else sharing.constants, fit.starts, fit.errors, fit.squares,
            None if in_whole else order.lengths[-1], fit.is_stiff, model.misfit, model.nats,
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
    def encoded(self) -> bytes:
        """The bytes of its parts."""
        return encode_value(self.parts)

    @classmethod
    def of_parts(cls, parts: ComparisonParts) -> "ModelComparison":
        """Return the comparison of these parts, which can do everything except calibrate."""
        estimator = MultipleShooting(parts.measurements, parts.tolerance, measured_rows=parts.measured_rows)
        made = cls(estimator, parts.names, parts.fixed, parts.leading, constraints=parts.constraints)
        score = replace(made.score, roughness=parts.roughness, rows=parts.rows, errors=parts.errors)
        return replace(made, calibration=score)

    def restrictions(self, equation: int) -> Restrictions:
        """Return the restrictions of an equation; a given equation has none."""
        return NONE if equation in self.fixed else self.constraints.restrictions.get(equation, NONE)

    def admitted(self, programs: Sequence[Program]) -> list[Program] | None:
        """Return `programs` as they may be fitted; None when one of them may not stand for its equation."""
        if not self.constraints.restrictions:
            return list(programs)
        admissible_programs = [self.restrictions(index).admitted(program) for index, program in enumerate(programs)]
        return (
            None
            if any(program is None for program in admissible_programs)
            else [program for program in admissible_programs if program is not None]
        )

    def system(
        self, programs: Sequence[Program], fixed_nodes: Sequence[Iterable[int]] = (), near: System | None = None,
        shared: Collection[SharedNumber] = (),
    ) -> System:  # fmt: skip
        """Return the system of `programs`.

        Args:
            programs: one for each equation.
            fixed_nodes: nodes of each whose constants stay as they are.
            near: where groups of trajectories have constants of their own, a system whose equations, if they are the
                same, say which; for others constants are fitted to each group's rows.
            shared: numbers that all groups, or several constants, have in common all the same.
        """
        fixed = [
            set(constant_places(program)) if index in self.fixed else set(fixed_nodes[index]) if fixed_nodes else set()
            for index, program in enumerate(programs)
        ]
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

    def places(self, system: System) -> list[Place]:
        """Return equation and node of each fitted constant of one of this comparison's systems."""
        firsts = [0, *(system.outputs + 1).tolist()]
        pairs = zip(system.places.tolist(), system.owners.tolist(), strict=True)
        return [(owner - len(self.leading), node - firsts[owner]) for node, owner in pairs]

    def _ranges(
        self, programs: Sequence[Program], fixed: Sequence[Collection[int]]
    ) -> tuple[FloatArray | None, FloatArray | None]:
        """Return bounds (P,) on the constants that are fitted, None without any."""
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
        """Return the fitted system of `programs`, None when it cannot be simulated or may not stand."""
        admitted = self.admitted(programs)
        if admitted is None:
            return None
        fit = fit_in_stages(self.estimator, self.system(admitted), lengths, steps)
        if fit is not None and self.score.errors is not None:
            fit = self.score.with_errors(fit, self.score.errors)
        return None if fit is None else self.measure(fit)

    def fit_beside(
        self, near: FittedModel, programs: Sequence[Program], steps: int = SETTINGS.effort.steps,
        shared: Collection[SharedNumber] = (),
    ) -> FittedModel | None:  # fmt: skip
        """Return the fitted `system` of `programs` and the rest, begun with the initial states of `near`.

        None when it cannot be simulated or may not stand.
        """
        return self._fit_from(self._beginning(near), programs, steps, shared)

    def _beginning(self, near: FittedModel) -> Beginning:
        """Return where the fits of systems near one begin."""
        fit = near.fit
        return Beginning(fit.starts, fit.errors, fit.is_stiff, None if self.groups is None else fit.system)

    def _fit_from(
        self, near: Beginning, programs: Sequence[Program], steps: int, shared: Collection[SharedNumber] = (),
    ) -> FittedModel | None:  # fmt: skip
        admitted = self.admitted(programs)
        if admitted is None:
            return None
        system = self.system(admitted, near=near.system, shared=shared)
        fit = self.estimator.fit(system, None, steps, near.starts, near.errors, is_stiff=near.is_stiff)
        return None if fit is None else self.measure(fit)

    def fit_exchanged(self, near: FittedModel, equation: int, program: Program, steps: int) -> FittedModel | None:
        """Return `near` with another program for one equation, see `fit_beside`."""
        return self.fit_beside(near, _exchanged(near, equation, [program])[0], steps)

    def narrow_down(
        self, near: FittedModel, equation: int, programs: Iterable[Program], rounds: Sequence[tuple[int, int]],
        until: float = math.inf,
    ) -> list[FittedModel]:  # fmt: skip
        """Return models of the best of `programs` for one equation, fewer of them after each of the `rounds`.

        Each round is a number of steps and the number of programs that are kept. Of equivalent programs only the one
        with the shortest description is kept, see `distinct`. Once the estimator's work is `until`, no more are taken
        in than the next few.
        """
        models: list[FittedModel] = []
        waiting = list(programs)
        beginning = self._beginning(near) if waiting else None
        for steps, kept in rounds:
            order = FitOrder(steps, near=beginning)
            models = self._fitted(order, _exchanged(near, equation, waiting), until)
            models = self.distinct(models, equation)[:kept]
            waiting = [model.programs[equation] for model in models]
        return self._remembered(equation, models)

    def foresee(
        self, near: FittedModel, lists: Mapping[int, Sequence[Program]], rounds: Sequence[tuple[int, int]]
    ) -> dict[int, Foreseen]:
        """Return the results of `narrow_down` for several equations, valid as long as `near` is the best model.

        They are fitted at the same time by other workers; empty without other workers or with a single equation.
        No work is counted, see `take_in`.
        """
        if len(lists) < 2 or not self.spread.is_shared:
            return {}
        foreseen = {equation: Foreseen([], 0) for equation in lists}
        waiting, beginning = dict(lists), self._beginning(near)
        for steps, kept in rounds:
            order = FitOrder(steps, near=beginning)
            systems = {equation: _exchanged(near, equation, programs) for equation, programs in waiting.items()}
            made = iter(self._fitted_elsewhere(order, [one for part in systems.values() for one in part]))
            for equation, part in systems.items():
                outcomes = [next(made) for _ in part]
                models = sorted(self._models(order, part, outcomes), key=lambda model: model.nats)
                models = self.distinct(models, equation)[:kept]
                foreseen[equation] = Foreseen(models, foreseen[equation].work + _work(outcomes))
                waiting[equation] = [model.programs[equation] for model in models]
        return foreseen

    def take_in(self, equation: int, foreseen: Foreseen) -> list[FittedModel]:
        """Return the models that were foreseen, their work counted as in `narrow_down`."""
        self.estimator.count(foreseen.work)
        return self._remembered(equation, foreseen.models)

    def measure(self, fit: TrajectoryFit) -> FittedModel:
        """Return the model that a fit of one of this comparison's systems gives."""
        self.spread.note(1)
        return self.score.model_of(fit)

    def _remembered(self, equation: int, models: Sequence[FittedModel]) -> list[FittedModel]:
        for model in models:
            key = (equation, structure(model.programs[equation]))
            known = self.tried.get(key)
            if known is None or model.nats < known.nats:
                self.tried[key] = model
        return list(models)

    def distinct(self, models: Iterable[FittedModel], equation: int) -> list[FittedModel]:
        """Return the models, sorted by nats, without models whose `equation` is equivalent to one before.

        Equations are equivalent if the misfits are equal, unless they differ off the measured curves: integration
        errors are the same for all equations that agree along the curves.
        """
        kept: list[FittedModel] = []
        misfits: list[tuple[float, int]] = []
        for model in models:
            misfit = model.misfit
            reach = 2.0 * _REPEATED * (1.0 + abs(misfit))  # no other one can be near enough
            near = misfits[bisect_left(misfits, (misfit - reach,)) : bisect_right(misfits, (misfit + reach, len(kept)))]
            if all(
                abs(misfit - other) > _REPEATED * (1.0 + abs(other)) or self.differ_beside(model, kept[place], equation)
                for other, place in near
            ):
                insort(misfits, (misfit, len(kept)))
                kept.append(model)
        return kept

    def differ_beside(self, model: FittedModel, other: FittedModel, equation: int) -> bool:
        """Tell whether the equations of two models differ off the measured curves by more than their errors.

        Without noise constants are known, and a thousandth counts; with noise, a difference that matters for
        predictions.
        """
        first, second = (values_of(one.programs[equation], self._beside) for one in (model, other))
        either = np.isfinite(first) | np.isfinite(second)
        share = math.sqrt(SETTINGS.inference.part) if self.score.is_noisy.any() else SETTINGS.common.negligible
        return bool(either.any()) and differ(first[either], second[either], share)

    def disputed_state(self, model: FittedModel, others: Sequence[FittedModel], equation: int) -> dict[str, float]:
        """Return the state off the measured curves, by name, where one equation differs most from the `others`.

        Each counts by its odds against `model`.
        """
        own = values_of(model.programs[equation], self._beside)
        apart = np.zeros_like(own)
        for other in others:
            odds = math.exp(-max(other.nats - model.nats, 0.0))
            apart += odds * np.nan_to_num(np.abs(values_of(other.programs[equation], self._beside) - own), posinf=0.0)
        place, states = int(np.argmax(apart)), len(self.estimator.measurements.smoothed)
        return {
            name: float(value)
            for name, value in zip(self.names, self._beside[:, place], strict=True)
            if name in self.estimator.measurements.variables[:states]
        }

    @cached_property
    def _beside(self) -> FloatArray:
        """Points (V, G) off the measured curves; none if groups have their own constants."""
        measurements = self.estimator.measurements
        points = np.concatenate([measurements.smoothed, measurements.inputs])
        moved = len(points if measurements.has_smoothed_inputs else measurements.smoothed)
        beside = points_beside(points, moved).T if self.groups is None else points[:, :0]
        return np.ascontiguousarray(beside[[measurements.variables.index(name) for name in self.names]])


FITS: Final[BatchFunction[ModelComparison, OrderedFit, FitOutcome]] = BatchFunction(
    "fits", ComparisonParts, OrderedFit, FitOutcome, ModelComparison.outcome, ModelComparison.of_parts
)
"""Systems fitted to the measurements of a comparison."""
