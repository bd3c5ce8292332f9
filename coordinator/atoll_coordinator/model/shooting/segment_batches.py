"""Segments as they travel: what an estimator is made of, which of its segments are integrated, and what comes of it.

Pure. Sensitivities stay where they were made: the blocks of the normal equations, of which a fit is a sum over
segments, are a tenth of their size.
"""

from dataclasses import dataclass

from atoll_coordinator.model.shooting.error_model import ErrorModel
from atoll_coordinator.model.shooting.measurements import Measurements
from atoll_coordinator.model.shooting.system import System
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints

Blocks = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
"""Of normal equations: those of the constants (P, P), of each segment's own numbers with these (G, P, L) and with each
other (G, L, L), and the right sides (P,) and (G, L)."""


@dataclass(frozen=True, eq=False)
class EstimatorParts:
    """What a `MultipleShooting` is made of."""

    measurements: Measurements
    tolerance: float
    measured_rows: int


@dataclass(frozen=True, eq=False)
class SegmentTask:
    """What is done with all segments. With `errors` there are sensitivities, weighed by these."""

    system: System
    errors: ErrorModel | None
    is_stiff: bool


@dataclass(frozen=True, eq=False)
class SegmentBatch:
    """Neighbouring segments (G, 2) to be integrated from their `starts` (G, L).

    The `task` is encoded, once for many batches, its system without programs. The segments `last`, by their place, go
    on to the first row of the next one.
    """

    task: bytes
    segments: Ints
    starts: FloatArray
    last: Ints


@dataclass(frozen=True, eq=False)
class SegmentOutcome:
    """What came of segments: the steps that they took, the `simulated` states (D, N) of their rows, and the rest.

    That is the `steepest` sensitivity, a state in its scale to a constant in its size; the `blocks` of each segment
    alone (G, ...), if there are sensitivities that are not too steep; and where segments go on, the states there (G, D)
    and their sensitivities (G, D, P + L). Steps are those of each of the integrations that it took.
    """

    taken: tuple[int, ...]
    simulated: FloatArray
    steepest: float
    blocks: Blocks | None
    reached: FloatArray
    ends: FloatArray
