"""The process that reads a MATLAB file of versions 5 to 7 with scipy: a damaged file can crash scipy.

``python -m atoll_coordinator.data.reading.matlab_child FILE`` writes the arrays to stdout as NPZ: ``names`` is a JSON
list of pairs (run, name); run 0 means that an array belongs to no run. The key of each array is the index of its pair.
"""

import io
import json
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from atoll_core.data.dataset import AnyArray


def main() -> None:
    """Read the file named on the command line; an error ends the process."""
    import scipy.io

    values: dict[str, object] = scipy.io.loadmat(sys.argv[1], simplify_cells=True)
    parts = parts_of({name: value for name, value in values.items() if not name.startswith("__")})
    arrays = {(run, name): array for run, part in enumerate(parts) for name, array in part.items()}
    packed = io.BytesIO()
    numbered: dict[str, Any] = {str(number): array for number, array in enumerate(arrays.values())}
    np.savez(packed, names=np.array(json.dumps([*arrays])), **numbered)
    sys.stdout.buffer.write(packed.getvalue())


def parts_of(values: Mapping[str, object]) -> list[dict[str, AnyArray]]:
    """Return the arrays that belong to no run, then the arrays of each run.

    Runs are the elements of a structure array or of a cell array, each a structure or an array. All such arrays have as
    many elements as the first.
    """
    runs: dict[str, list[object]] = {}
    for name, value in values.items():
        items = _items(value)
        are_arrays = all(
            isinstance(item, np.ndarray) and item.dtype.kind in "biuf" and item.ndim in (1, 2) and item.size > 1
            for item in items
        )
        is_run = are_arrays or (all(isinstance(item, dict) for item in items) and not _are_rows(items))
        if items and is_run and len(items) == len(next(iter(runs.values()), items)):
            runs[name] = items
    parts = [flat({name: value for name, value in values.items() if name not in runs})]
    parts += [{} for _ in next(iter(runs.values()), [])]
    for name, items in runs.items():
        for run, item in enumerate(items, start=1):
            parts[run] |= flat(item if isinstance(item, dict) else {name: item})
    return parts


def _items(value: object) -> list[object]:
    """Return the elements of a structure array or of a cell array; an empty list for any other value."""
    if isinstance(value, np.ndarray) and value.dtype.kind == "O":
        items: list[object] = value.ravel().tolist()
        return items
    return [*value] if isinstance(value, list) else []


def _are_rows(items: Sequence[object]) -> bool:
    """Tell whether elements are rows: structures of single values, as MATLAB's `table2struct` makes from tables."""
    return bool(items) and all(
        isinstance(item, dict) and item and all(np.ndim(part) == 0 for part in item.values()) for item in items
    )


def flat(values: Mapping[str, object]) -> dict[str, AnyArray]:
    """Return the arrays by name; a field of a structure by the field's name, or by both names if that name is taken.

    A value without numbers or text becomes a single empty text.
    """
    arrays: dict[str, AnyArray] = {}
    for name, value in values.items():
        rows = _items(value)
        if _are_rows(rows):
            records = [row for row in rows if isinstance(row, dict)]
            value = {field: np.array([row.get(field, np.nan) for row in records]) for field in records[0]}
        if isinstance(value, dict):
            inner = flat(value)
            arrays |= {field if field not in arrays else f"{name}.{field}": part for field, part in inner.items()}
        else:
            is_plain = isinstance(value, (np.ndarray, np.generic, str, int, float, complex))
            array = np.asarray(value) if is_plain else np.array("")
            arrays[name] = array if array.dtype.kind in "biufcU" and array.ndim <= 2 else np.array("")
    return arrays


if __name__ == "__main__":
    main()
