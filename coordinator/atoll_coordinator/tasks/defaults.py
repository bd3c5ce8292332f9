"""Fills in the fields of a configuration that depend on the data."""

from typing import Final

from atoll_coordinator.data.prior_knowledge import resolve_prior
from atoll_coordinator.data.recording import Source
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset

ROWS_CLEAN: Final = 16
ROWS_NOISY: Final = 32
RUNNERS_UP_NOISY: Final = 8


def resolve(config: JobConfig, dataset: Dataset) -> JobConfig:
    """Return `config` with all fields that workers need: rows of a predictor, terminals, runners-up.

    Left-hand sides as users write them become names of variables; raises UsageError for unknown left-hand sides.
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


def with_units(config: JobConfig, source: Source | None) -> JobConfig:
    """Return `config` with the units of all columns, from the options and from the file's header."""
    if source is None or not source.units:
        return config
    return config.model_copy(update={"data": config.data.model_copy(update={"units": dict(source.units)})})
