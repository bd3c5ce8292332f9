"""What a page is about: a result, and where there is one its model and how it moves."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeVar

from atoll.display.series import label
from atoll.model.equations import DIGITS
from atoll.model.model import Model
from atoll.report.chart import Axis
from atoll_coordinator.result.findings import System
from atoll_coordinator.result.listed_trajectories import Simulated
from atoll_coordinator.result.result import Result
from atoll_core.errors import DataError, UsageError
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix

if TYPE_CHECKING:
    from atoll.analysis.analysis import Analysis
    from atoll.experiments.determination import Identifiability
    from atoll.experiments.suggestion import Suggestions


Found = TypeVar("Found")
MOST_PROFILES: Final = 12
"""Constants whose profiles are drawn; of more they are not made, since each takes a fit for every point."""


@dataclass(frozen=True)
class Findings:
    """A result, and what is found of its model (None where an equation was not found).

    These are the dynamics, what the data determine of the constants, and the experiments to make next; each is None
    where there is nothing to find it from. `unanalysed` says why there are no dynamics, "" where there are.
    """

    result: Result
    model: Model | None
    analysis: "Analysis | None" = None
    unanalysed: str = ""
    identifiability: "Identifiability | None" = None
    suggestions: "Suggestions | None" = None

    @classmethod
    def of(cls, result: Result) -> "Findings":
        """Return the findings of a result, which takes a few seconds for two states."""
        try:
            model = Model(result)
        except UsageError as error:
            return cls(result, None, None, str(error))
        if model.is_regression:
            return cls(result, model, None, "the model has no time")
        has_profiles = count_constants(result) <= MOST_PROFILES
        identifiability = _found(model.identifiability) if has_profiles else None
        suggestions = _found(model.suggest)
        try:
            return cls(result, model, model.analyse(), "", identifiability, suggestions)
        except UsageError as error:
            return cls(result, model, None, str(error), identifiability, suggestions)

    @property
    def system(self) -> System:
        """What the columns are, as far as the result says."""
        return self.result.columns

    @property
    def time(self) -> str:
        """The name of the time column."""
        return self.result.time

    @property
    def trajectories(self) -> tuple[Simulated, ...]:
        """The simulated trajectories; empty where nothing was simulated."""
        return self.result.simulated

    def rounded(self, expression: str) -> str:
        """Return an expression with its constants in a few digits."""
        names = self.result.names
        return to_infix(from_infix(expression, names), names, digits=DIGITS)

    def labelled(self, column: str) -> str:
        """Return a column name with its unit."""
        return label(self.result, column)

    def axis(self, column: str) -> Axis:
        """Return the axis of a column, labelled with its unit."""
        return Axis(self.labelled(column))


def count_constants(result: Result) -> int:
    """Return how many constants were fitted, factors of 1 that nobody writes included."""
    return sum(len(equation.constants) + len(equation.implied) for equation in result.equations)


def _found(find: Callable[[], Found]) -> Found | None:
    """Return what is found; None of a result without the measurements that it takes."""
    try:
        return find()
    except (UsageError, DataError):
        return None
