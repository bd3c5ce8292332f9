"""Fields of a configuration that are left open until the data are known."""

from typing import Final

from atoll.config import JobConfig
from atoll.data.dataset import Dataset, Target
from atoll_coordinator.data.prior_knowledge import resolve_prior

ROWS_CLEAN: Final = 16
ROWS_NOISY: Final = 32
RUNNERS_UP_NOISY: Final = 8
STAGNATION_CLEAN: Final = 60
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


def stagnation_of(config: JobConfig, target: Target) -> int:
    """Return the epochs without a better equation after which the search for that of `target` ends."""
    return config.budget.stagnation or (STAGNATION_NOISY if target.is_noisy else STAGNATION_CLEAN)
