"""What a result says of where it comes from: the data, what their columns are, the settings.

Plain dictionaries, lists, texts and numbers for ``result.json``.
"""

from typing import Any

from atoll.config import JobConfig
from atoll_coordinator.data.recording import Preparation, Source


def data(its: Source | None) -> dict[str, Any] | None:
    """Return the digest, the files and the number of rows of the table; None where it is not known."""
    return None if its is None else {"digest": its.digest, "files": list(its.files), "rows": its.rows}


def system(given: Preparation) -> dict[str, Any] | None:
    """Return what the columns are, their units, and the range of each variable in the rows that were searched.

    All by column name; angles are in radians there. None where the source is not known.
    """
    its = given.source
    if its is None:
        return None
    ranges = zip(given.dataset.symbols, given.dataset.inputs, strict=True)
    return {
        "kind": _kind(given, its),
        "order": its.order,
        "time": its.time,
        "states": list(its.states),
        "velocities": list(its.velocities),
        "inputs": list(its.inputs),
        "target": its.target,
        "units": dict(its.units),
        "ranges": {name: [float(values.min()), float(values.max())] for name, values in ranges},
    }


def _kind(given: Preparation, its: Source) -> str:
    if its.target is not None:
        return "regression"
    return "process" if given.process is not None else "dynamics"


def settings(config: JobConfig) -> dict[str, Any]:
    """Return the settings that are not the preset's defaults, as a job file has them."""
    return config.model_dump(mode="json", exclude_defaults=True)
