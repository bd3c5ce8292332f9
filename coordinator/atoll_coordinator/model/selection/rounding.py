"""Constants of a system made simple numbers, as far as the trajectories cannot tell the difference.

As `atoll_coordinator.model.regression.rounding` does for one equation: near its minimum the misfit is a quadratic form
of the constants, by which a beam of decisions is built up; the best whole decisions are fitted and measured.
"""

from collections.abc import Sequence

from atoll.expression.program import Program, constant_places, with_constants
from atoll_coordinator.model.criteria import rounded_system_length
from atoll_coordinator.model.regression.rounding import Decision, decisions
from atoll_coordinator.model.regression.simple_numbers import fitted_length, simple_numbers
from atoll_coordinator.model.selection.comparison import FittedModel, ModelComparison
from atoll_coordinator.model.settings import SETTINGS
from atoll_coordinator.model.shooting.covariance import bounded_covariance
from atoll_coordinator.model.structure.algebra import tidied


def round_system(comparison: ModelComparison, model: FittedModel) -> tuple[Program, ...]:
    """Return the programs of the shortest description that comes of `model` by making constants simple."""
    fit = model.fit
    if not 0 < len(fit.system.places) <= SETTINGS.selection.most_rounded_constants:
        return model.programs
    means, spread = fit.system.values, comparison.correlation_length * bounded_covariance(fit)
    errors = [float(variance) ** 0.5 for variance in spread.diagonal().clip(0.0)]
    best = rounded_system_length(model.misfit, model.programs, map(fitted_length, means.tolist(), errors))
    shown = model.programs
    for decision in decisions(means, spread)[: SETTINGS.selection.roundings_measured]:
        measured = _measured(comparison, model, decision)
        if measured is not None and measured[0] <= best:
            best, shown = measured
    return shown


def _measured(
    comparison: ModelComparison, model: FittedModel, decision: Decision
) -> tuple[float, tuple[Program, ...]] | None:
    """Return the nats and the programs of a decision, its open constants fitted; None when it cannot be simulated."""
    numbers = dict(decision.numbers)
    programs, fixed = _decided(comparison, model.programs, numbers)
    after = comparison.fit_beside(model, programs, SETTINGS.selection.rounding_steps, fixed)
    if after is None:
        return None
    fit = after.fit
    open_errors = [
        float(variance) ** 0.5
        for variance in (comparison.correlation_length * bounded_covariance(fit)).diagonal().clip(0.0)
    ]
    lengths = [sum(map(fitted_length, fit.system.values.tolist(), open_errors)), sum(map(_price, numbers.values()))]
    shown = tuple(
        program if index in comparison.fixed else tidied(program) for index, program in enumerate(after.programs)
    )
    return rounded_system_length(after.misfit, shown, lengths), shown


def _price(number: float) -> float:
    return 0.0 if abs(number) in (0.0, 1.0) else min(simple_numbers(number, 0.0).values(), default=0.0)


def _decided(
    comparison: ModelComparison, programs: Sequence[Program], numbers: dict[int, float]
) -> tuple[list[Program], list[set[int]]]:
    """Return the programs with decided constants, and the nodes of these."""
    changed: list[Program] = []
    fixed: list[set[int]] = []
    index = 0
    for equation, program in enumerate(programs):
        places = [] if equation in comparison.fixed else constant_places(program)
        chosen = {place: numbers[index + k] for k, place in enumerate(places) if index + k in numbers}
        changed.append(with_constants(program, chosen))
        fixed.append(set(chosen))
        index += len(places)
    return changed, fixed
