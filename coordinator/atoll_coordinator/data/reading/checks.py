"""Checks of measurements before anything is computed from them. Each failure is one sentence with advice. Pure."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from atoll.data.dataset import FloatArray
from atoll.data.table import Table
from atoll.errors import DataError
from atoll_coordinator.data.reading.columns import Roles

MIN_ROWS: Final = 5
"""Fewest rows of a trajectory that has a derivative, and of any search."""

TURNS: Final = ((6.283185307179586, "2 pi", ""), (360.0, "360", ":deg"))
"""A full turn, how it is called, and what `--angle` appends for its unit."""


def finite_rows(table: Table, roles: Roles, counted: list[int], drop: bool) -> tuple[list[int], str | None]:
    """Return those of the rows `counted` whose used columns are all finite, and a sentence when rows were dropped.

    Raises:
        DataError: when there are others and `drop` is false, or nothing is left.
    """
    used = [table.names.index(name) for name in roles.used]
    bad = ~np.isfinite(table.columns[used])
    uncounted = np.ones(table.rows, dtype=np.bool_)
    uncounted[counted] = False
    bad &= ~uncounted
    kept = [int(row) for row in np.flatnonzero(~(bad.any(axis=0) | uncounted))]
    if len(kept) == len(counted):
        return kept, None
    if not drop:
        raise DataError(_not_finite(table, [table.names[index] for index in used], bad))
    if not kept:
        raise DataError(f"every row of {table.files[0]} holds NaN or infinity; nothing is left to search")
    count = len(counted) - len(kept)
    return kept, f"{count} of {table.rows} rows hold NaN or infinity and were dropped."


def _not_finite(table: Table, names: Sequence[str], bad: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> str:
    """Name the first bad column and its rows, and say how many rows are bad over all."""
    first = next(index for index in range(len(names)) if bad[index].any())
    rows = [int(row) for row in np.flatnonzero(bad[first])]
    values = table.column(names[first])
    kind = "NaN or an empty cell" if all(np.isnan(values[row]) for row in rows) else "NaN or infinity"
    text = f"column '{names[first]}' holds {kind} in {table.places(rows)}"
    others = [name for name, its in zip(names, bad, strict=True) if its.any() and name != names[first]]
    if others:
        total = int(bad.any(axis=0).sum())
        text += f", and so do {', '.join(others)} ({total} rows over all)"
    return text + "; correct them, or add --missing drop to leave such rows out"


def check_rows(table: Table, count: int) -> None:
    """Raise DataError when `count` rows are too few for any search."""
    if count < MIN_ROWS:
        rows = "row" if count == 1 else "rows"
        raise DataError(f"{table.files[0]} has {count} {rows} of data; at least {MIN_ROWS} are needed")


def check_varies(table: Table, name: str, values: FloatArray, part: str) -> None:
    """Raise DataError when a column in the part of a state or target is constant."""
    if len(values) and np.all(values == values[0]):
        value = f"{float(values[0]) + 0.0:g}"
        advice = "choose states with --states, or make it an input with --inputs" if part == "state" else "name another"
        raise DataError(f"{part} '{name}' of {table.files[0]} is constant ({value} in every row); {advice}")


def check_times(table: Table, name: str, times: FloatArray, rows: Sequence[int]) -> None:
    """Raise DataError unless `times`, one trajectory at table rows `rows`, ascend strictly."""
    if len(times) > 1 and np.all(times == times[0]):
        raise DataError(f"the time column '{name}' is constant ({float(times[0]):g}); name another with --time")
    for row, (before, after) in zip(rows[1:], pairwise(times.tolist()), strict=True):
        if after == before:
            problem = f"time {after!r} is repeated at {table.places([row])}"
            raise DataError(f"{problem}; keep one row, or mark trajectories (--trajectory COLUMN or blank rows)")
        if after < before:
            problem = f"time goes back from {before!r} to {after!r} at {table.places([row])}"
            raise DataError(f"{problem}; sort the rows, or mark trajectories (--trajectory COLUMN or blank rows)")


def check_length(table: Table, rows: Sequence[int], number: int) -> None:
    """Raise DataError when trajectory `number` (from 1) is too short to be differentiated."""
    if len(rows) < MIN_ROWS:
        count = f"{len(rows)} {'row' if len(rows) == 1 else 'rows'}"
        place = table.places([rows[0]])
        raise DataError(
            f"trajectory {number}, which begins in {place}, has {count}; at least {MIN_ROWS} are needed: "
            "leave it out, or check what separates trajectories"
        )


def check_no_turns(name: str, runs: Sequence[FloatArray]) -> None:
    """Raise DataError when a state jumps by a full turn, as a wrapped angle does.

    A wrapped angle stays within one turn, and where it jumps it moves on smoothly once the turn is taken out.
    """
    low = min(float(np.min(run)) for run in runs)
    high = max(float(np.max(run)) for run in runs)
    for turn, called, suffix in TURNS:
        if not 0.5 * turn < high - low <= 1.001 * turn:
            continue
        jumps = sum(_jumps(run, turn) for run in runs)
        if jumps:
            count = f"{jumps} time{'s' if jumps > 1 else ''}"
            raise DataError(
                f"state '{name}' jumps by about {called} {count}, as a wrapped angle does; "
                f"add --angle {name}{suffix} so that it is unwrapped"
            )


def _jumps(run: FloatArray, turn: float) -> int:
    """Count isolated steps that are small only modulo `turn`."""
    steps = np.abs(np.diff(run))
    count = 0
    for index, step in enumerate(steps.tolist()):
        near = [float(steps[other]) for other in (index - 1, index + 1) if 0 <= other < len(steps)]
        around = max((each for each in near if each < 0.5 * turn), default=0.0)
        if step > 0.5 * turn and step > 4.0 * around and abs(step - turn) <= 3.0 * around + 1e-3 * turn:
            count += 1
    return count
