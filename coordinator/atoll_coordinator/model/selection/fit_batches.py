"""Fits of systems as messages: the parts of a comparison, the systems to be fitted, and summaries of fits. Pure.

A summary has the numbers from which one integration makes the whole fit again: states, residuals and normal equations
are hundreds of times as large, and most candidates do not need them.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from atoll_coordinator.model.criteria import TrajectoryMisfit
from atoll_coordinator.model.selection.grouped_rows import RowsByGroup
from atoll_coordinator.model.shooting.error_model import ErrorModel
from atoll_coordinator.model.shooting.measurements import Measurements
from atoll_coordinator.model.shooting.system import System
from atoll_coordinator.model.shooting.trajectory_fit import TrajectoryFit
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import Program
from atoll_core.expression.restrictions import Restrictions


@dataclass(frozen=True, eq=False)
class ComparisonParts:
    """Parts of a `ModelComparison`; it was calibrated to `errors` and `misfit`."""

    measurements: Measurements
    tolerance: float
    measured_rows: int
    names: tuple[str, ...]
    fixed: frozenset[int]
    leading: tuple[Program, ...]
    restrictions: Mapping[int, Restrictions]
    groups: RowsByGroup | None
    errors: ErrorModel | None
    misfit: TrajectoryMisfit


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

    A fit takes at most `steps` steps, and ends early if it will not reach a description of `most` nats.
    """

    steps: int
    lengths: tuple[int | None, ...] = ()
    near: Beginning | None = None
    most: float = math.inf


@dataclass(frozen=True, eq=False)
class FitBatch:
    """Systems, the programs of each, that are fitted alike."""

    order: FitOrder
    systems: tuple[tuple[Program, ...], ...]


@dataclass(frozen=True, eq=False)
class FitSummary:
    """The numbers of a fit: `constants` of all nodes, by group if there are any, and the rest that decides it.

    `length` is the length of its segments (rows; None: whole trajectories); `squares` are mean squares of residuals.
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


@dataclass(frozen=True, eq=False)
class FitOutcome:
    """The fit of a system, None if it could not be fitted, and its work."""

    summary: FitSummary | None
    work: int


@dataclass(frozen=True, eq=False)
class SummarizedFit:
    """A fit of which the summary is known; `complete` integrates it once more for the rest."""

    squares: FloatArray
    complete: Callable[[], TrajectoryFit] = field(repr=False)
