"""What a job is made of: its configuration, and its table."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from atoll_core.config import PRESETS, JobConfig, Preset
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table

UNMET: Final = 1e-300
"""A target error that ends no search."""

NEVER: Final = 10**9
"""More epochs than any search has."""

UNENDING: Final[Mapping[str, Any]] = {"target_error": UNMET, "stagnation": NEVER}
"""The budget of a search that only its number of epochs or its time ends."""


def configured(
    seed: int = 0, data: Mapping[str, Any] | None = None, budget: Mapping[str, Any] | None = None,
    operators: Sequence[str] | None = None, preset: Preset = "default", **evolution: Any,
) -> JobConfig:  # fmt: skip
    """Return a preset with a seed, some fields of its data, budget and evolution, and perhaps other operators."""
    config = PRESETS[preset]
    changes: dict[str, Mapping[str, Any]] = {"data": data or {}, "budget": budget or {}, "evolution": evolution}
    if operators is not None:
        changes["space"] = {"operators": tuple(operators)}
    update = {part: getattr(config, part).model_copy(update=dict(fields)) for part, fields in changes.items()}
    return config.model_copy(update={"seed": seed, **update})


def table_of_columns(columns: Mapping[str, FloatArray], file: str, starts: Sequence[int] = (0,)) -> Table:
    """Return the table that a `file` with these columns (R,) would be read as; trajectories begin at `starts`."""
    values = np.ascontiguousarray(np.stack([*columns.values()]))
    rows = np.arange(values.shape[1], dtype=np.int64)
    return Table(tuple(columns), ("",) * len(columns), values, tuple(starts), (file,), np.zeros_like(rows), rows + 2)
