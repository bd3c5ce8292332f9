"""Constants of a system as they are shown, by the information of the trajectories.

As `atoll_coordinator.model.regression.rounding` does for one equation: near its minimum the misfit is a quadratic form
of the constants, which says which simple numbers the data single out and how many digits estimates have.
"""

import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Final

from atoll_coordinator.model.regression.rounding import Estimates, Rounding, allowed_growth, find_simple
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.shooting.system import System
from atoll_coordinator.model.shooting.trajectory_fit import bounded_covariance
from atoll_coordinator.result.equations import SimpleNumber, SimpleTogether
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import Program, constant_places, with_constants
from atoll_core.expression.writing.shortest import collected


@dataclass(frozen=True, eq=False)
class RoundedSystem:
    """The equations with constants as they are shown; `simple` has for each of its constants the nearest simple number.

    `together` has the joint odds of the simple numbers shown in each equation, empty if these were not judged. A given
    equation has none.
    """

    programs: tuple[Program, ...]
    simple: tuple[tuple[SimpleNumber | None, ...], ...]
    together: tuple[SimpleTogether | None, ...] = ()


def round_system(comparison: ModelComparison, model: FittedModel) -> tuple[Program, ...]:
    """Return the programs of `model` with those constants simple that the trajectories single out, the others fitted.

    As they are where there are too many, or where that does not describe the trajectories as well as it should.
    """
    fit = model.fit
    if not 0 < len(fit.system.places) <= SETTINGS.effort.beam:
        return model.programs
    means, spread = fit.system.values, _covariance(comparison, model)
    numbers = find_simple(means, spread)
    if not numbers:
        return model.programs
    programs, fixed = _decided(comparison, model.programs, numbers)
    after = comparison.fit_beside(model, programs, SETTINGS.effort.steps, fixed)
    if after is None or after.misfit > model.misfit + allowed_growth(means, spread, numbers):
        return model.programs
    return tuple(
        program if index in comparison.fixed else collected(program) for index, program in enumerate(after.programs)
    )


class ShownConstants:
    """The constants of a fitted system as they are shown, in any number of digits; simple numbers are found once."""

    def __init__(self, comparison: ModelComparison, model: FittedModel) -> None:
        """Show the structure of `model`, all constants fitted in this comparison."""
        self._comparison: Final = comparison
        self._model: Final = model

    def rounded(self, digits: int, estimates: Collection[int] = ()) -> RoundedSystem:
        """Return the programs with constants as they are shown.

        Args:
            digits: number of digits of the standard errors to which estimates are rounded.
            estimates: fitted numbers, by index, that stay estimates although a simple number is singled out.
        """
        comparison, programs, system = self._comparison, self._model.programs, self._model.fit.system
        if not system.count:
            return RoundedSystem(programs, tuple(() for _ in programs))
        is_many = system.count > SETTINGS.effort.beam
        rounding = self._estimates.rounded(digits, range(system.count) if is_many else estimates)
        values = rounding.values.tolist() if system.sharing is None else _tidied(system.by_place(rounding.values)[0])
        changed, _ = _decided(comparison, programs, dict(enumerate(values)))
        simple = iter(_multiplied(system, rounding.simple))
        counts = [
            0 if index in comparison.fixed else len(constant_places(program)) for index, program in enumerate(changed)
        ]
        ends = [0, *accumulate(counts)]
        return RoundedSystem(
            tuple(changed),
            tuple(tuple(next(simple) for _ in range(count)) for count in counts),
            tuple(_in_one_equation(system, rounding, *span) for span in pairwise(ends)),
        )

    @cached_property
    def _estimates(self) -> Estimates:
        return Estimates(self._model.fit.system.values, _covariance(self._comparison, self._model))


def _in_one_equation(system: System, rounding: Rounding, first: int, last: int) -> SimpleTogether | None:
    """Return the joint odds of the simple numbers of the constants from `first` until before `last`."""
    simple_together = rounding.together(system.columns[0, first:last].tolist())
    if simple_together is None or system.sharing is None:
        return simple_together
    multiples = system.sharing.multiples[first:last]
    pairs = zip(simple_together.constants, simple_together.values, strict=True)
    return simple_together.replaced(values=tuple((value or 0.0) * float(multiples[place]) for place, value in pairs))


def _tidied(values: FloatArray) -> list[float]:
    """Return multiples of decimals as decimals."""
    return [float(f"{value:.{sys.float_info.dig}g}") for value in values.tolist()]


def _multiplied(system: System, simple: Sequence[SimpleNumber | None]) -> Iterator[SimpleNumber | None]:
    """Yield the simple number near each constant, given those near the numbers (Q,) that they are multiples of."""
    for place, number in enumerate(system.columns[0].tolist()):
        remark, multiple = simple[number], 1.0 if system.sharing is None else float(system.sharing.multiples[place])
        yield None if remark is None else remark.replaced(value=(remark.value or 0.0) * multiple)


def _covariance(comparison: ModelComparison, model: FittedModel) -> FloatArray:
    return comparison.score.inflation(model) * bounded_covariance(model.fit)


def _decided(
    comparison: ModelComparison, programs: Sequence[Program], numbers: Mapping[int, float]
) -> tuple[list[Program], list[set[int]]]:
    """Return the programs with decided constants, and the nodes of these."""
    changed: list[Program] = []
    fixed: list[set[int]] = []
    index = 0
    for equation, program in enumerate(programs):
        places = [] if equation in comparison.fixed else constant_places(program)
        chosen = {place: numbers[index + k] for k, place in enumerate(places) if index + k in numbers}
        bounds, made = comparison.restrictions(equation).bounds, with_constants(program, chosen)
        changed.append(made if bounds is None else bounds.clipped(made))
        fixed.append(set(chosen))
        index += len(places)
    return changed, fixed
