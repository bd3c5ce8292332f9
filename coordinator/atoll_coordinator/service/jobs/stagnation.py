"""When the search of an equation ends where the configuration leaves it open, and how many rows count."""

from typing import Final

from atoll_coordinator.data.recording import STENCIL_ROWS, Recording
from atoll_coordinator.service.search.ending import Stagnation
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Target

STAGNATION_GIVEN: Final = 60
"""Given left-hand sides have no trajectories by which refining could go on from an equation that comes close; and
who gives a target error wants it to be met."""

STAGNATION_CLEAN: Final = 5
"""The least; it grows with the epochs that the last improvement took. Measured on random systems simulated at solver
tolerances: of 48 equations found in 24 to 30 epochs all are found as well with 3, 5, 8 or 12 (ADR 0033)."""

STAGNATION_NOISY: Final = 3


def stagnation_of(config: JobConfig, target: Target, recording: Recording | None) -> Stagnation:
    """Return after which epochs without a better equation the search for that of `target` ends.

    `recording` is what the target was estimated from, None where it was given.
    """
    if config.budget.stagnation is not None:
        return Stagnation(config.budget.stagnation)
    if target.is_noisy:
        return Stagnation(STAGNATION_NOISY)
    if recording is None or config.budget.target_error is not None:
        return Stagnation(STAGNATION_GIVEN)
    return Stagnation(STAGNATION_CLEAN, grows=True)


def independent_rows(target: Target, recording: Recording | None) -> float:
    """Return how many rows of a target have errors of their own.

    An estimate by a polynomial of degree d over s rows rests on d + 1 numbers made of them. Tables without noise are
    those of simulators, whose errors go together over at least as many rows as an interpolation takes.
    """
    rows = float(len(target.values))
    if recording is None:
        return rows
    smoothing = recording.smoothing[recording.states.index(target.variable)]
    if smoothing.span is None or smoothing.degree is None:
        return rows / STENCIL_ROWS
    return rows * min(1.0, (smoothing.degree + 1.0) / smoothing.span)
