"""Fields of a configuration that are left open until the data are known."""

from typing import Final

from common.config import JobConfig
from common.dataset import Dataset
from coordinator.data.prior import resolve_prior

CLEAN_FLOOR: Final = 1e-3
"""Targets known better than this, relative to their spread, count as noise-free."""

ROWS_CLEAN: Final = 16
ROWS_NOISY: Final = 64


def resolve(config: JobConfig, dataset: Dataset) -> JobConfig:
    """Return `config` with the rows of a predictor and the number of terminals filled in, as workers need it.

    Left-hand sides that people wrote become the names of their variables; raises UsageError where that cannot be.
    """
    config = resolve_prior(config, dataset.variables, dataset.symbols)
    rows = config.predictors.rows or _rows(dataset)
    terminals = config.space.terminals_for(len(dataset.names))
    return config.model_copy(
        update={
            "predictors": config.predictors.model_copy(update={"rows": rows}),
            "space": config.space.model_copy(update={"terminals": terminals}),
        }
    )


def _rows(dataset: Dataset) -> int:
    is_clean = all(target.floor < CLEAN_FLOOR and target.noise == 0.0 for target in dataset.targets)
    return ROWS_CLEAN if is_clean else ROWS_NOISY
