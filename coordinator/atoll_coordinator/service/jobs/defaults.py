"""Fields of a configuration that are left open until the data are known."""

from typing import Final

from atoll_coordinator.data.prior_knowledge import resolve_prior
from atoll_coordinator.data.recording import STENCIL_ROWS, Recording, Source
from atoll_coordinator.service.search.ending import Stagnation
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset, Target

ROWS_CLEAN: Final = 16
ROWS_NOISY: Final = 32
RUNNERS_UP_NOISY: Final = 8
STAGNATION_GIVEN: Final = 60
"""Given left-hand sides have no trajectories by which refining could go on from an equation that comes close; and
who gives a target error wants it to be met."""

STAGNATION_CLEAN: Final = 5
"""The least; it grows with the epochs that the last improvement took. Measured on random systems simulated at solver
tolerances: of 48 equations found in 24 to 30 epochs all are found as well with 3, 5, 8 or 12 (ADR 0033)."""

STAGNATION_NOISY: Final = 3


def resolve(config: JobConfig, dataset: Dataset) -> JobConfig:
    """Return `config` with all filled in that workers need: rows of a predictor, terminals, runners-up.

    Left-hand sides that people wrote become the names of their variables; raises UsageError where that cannot be.
    """
    config = resolve_prior(config, dataset.variables, dataset.symbols)
    is_noisy = any(target.is_noisy for target in dataset.targets)
    rows, runners_up = config.predictors.rows, config.evolution.runners_up
    rows = rows or (ROWS_NOISY if is_noisy else ROWS_CLEAN)
    runners_up = (RUNNERS_UP_NOISY if is_noisy else 0) if runners_up is None else runners_up
    terminals = config.space.terminals_for(len(dataset.names))
    return config.model_copy(
        update={
            "predictors": config.predictors.model_copy(update={"rows": rows}),
            "evolution": config.evolution.model_copy(update={"runners_up": runners_up}),
            "space": config.space.model_copy(update={"terminals": terminals}),
        }
    )


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


def with_units(config: JobConfig, source: Source | None) -> JobConfig:
    """Return `config` with the units of all columns: those that were given, and those of the file's header."""
    if source is None or not source.units:
        return config
    return config.model_copy(update={"data": config.data.model_copy(update={"units": dict(source.units)})})
