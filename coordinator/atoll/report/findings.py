"""The content of a page: a result and, if the result is complete, its model, dynamics and identifiability."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, TypeVar

from atoll.analysis.analyse import analyse_model
from atoll.analysis.analysis import Analysis
from atoll.display.curves import ModelCurves, choose_trajectories, curves_of, label
from atoll.experiments.designs import DesignRequest
from atoll.experiments.identifiability import Identifiability, identify
from atoll.experiments.suggestion import Suggestions, suggest
from atoll.model.core import ModelCore
from atoll.model.equations import LEVEL
from atoll.report.markup import Axis, Chart
from atoll_coordinator.model.batches import Spread
from atoll_coordinator.result.listed_trajectories import Simulated
from atoll_coordinator.result.result import Result
from atoll_core.errors import DataError, UsageError

ValueT = TypeVar("ValueT")
MOST_PROFILES: Final = 12
"""Largest number of constants whose profiles are drawn: each point of a profile needs a fit."""


@dataclass(frozen=True)
class Findings:
    """A result, and its model (None if an equation was not found).

    The dynamics, the identifiability of the constants and the suggested experiments are None if they cannot be
    computed. `unanalysed` says why the dynamics were not analysed; it is "" if they were.
    """

    result: Result
    model: ModelCore | None
    analysis: Analysis | None = None
    unanalysed: str = ""
    identifiability: Identifiability | None = None
    suggestions: Suggestions | None = None

    @classmethod
    def of(cls, result: Result, spread: Spread | None = None) -> "Findings":
        """Return the findings of a result; this takes a few seconds for two states. `spread` distributes the work."""
        try:
            model = ModelCore(result)
        except UsageError as error:
            return cls(result, None, None, str(error))
        if model.is_regression:
            return cls(result, model, None, "the model has no time")
        has_few = count_constants(result) <= MOST_PROFILES and not model.groups
        identifiability = _try(lambda: identify(result, None, LEVEL, spread)) if has_few else None
        suggestions = _try(lambda: suggest(result, DesignRequest(bounds={}), None, spread))
        try:
            return cls(result, model, analyse_model(model, spread=spread), "", identifiability, suggestions)
        except UsageError as error:
            return cls(result, model, None, str(error), identifiability, suggestions)

    @cached_property
    def curves(self) -> Sequence[tuple[Simulated, ModelCurves]]:
        """The simulated trajectories that are drawn, at most `SHOWN`, with their curves."""
        return [(part, curves_of(self.model, part)) for part in choose_trajectories(self.result.simulated)]

    def label(self, column: str) -> str:
        """Return a column name with its unit."""
        return label(self.result, column)

    def over_time(self, title: str, column: str) -> Chart:
        """Return an empty chart of a column over time, both labelled with their units."""
        return Chart(title, Axis(self.label(self.result.time)), Axis(self.label(column)))


def count_constants(result: Result) -> int:
    """Return the number of fitted constants, including coefficients of 1 that the text does not show."""
    return sum(
        sum(equation.given is None or constant.fitted is not None for constant in equation.constants)
        + len(equation.implied)
        for equation in result.equations
    )


def _try(find: Callable[[], ValueT]) -> ValueT | None:
    """Return the value of a computation; None if the result lacks the measurements for it."""
    try:
        return find()
    except (UsageError, DataError):
        return None
