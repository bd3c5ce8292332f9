"""Drops incomplete rows, and checks the measured values. Each failure is one sentence with advice. Pure.

`data/searched_rows.py` leaves rows with uncertain derivatives out of the search.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll_coordinator.data.roles.names_and_options import TIME_NAMES
from atoll_coordinator.data.roles.roles import Roles
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import DataConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from atoll_core.errors import DataError

BoolArray = npt.NDArray[np.bool_]
MIN_ROWS = SETTINGS.common.fewest_rows
SMALLEST: Final = 1e-150
"""Guard: the square of a number below this value underflows; the square of a number above the inverse of this value
overflows."""
_JUMP: Final = 3.0
"""Limit for jumps of a wrapped angle, used twice: a jump is this many times as large as every other step, and its
difference from a full turn is at most this many times the steps next to it."""
_TURNS: Final = ((6.283185307179586, "2 pi", ""), (360.0, "360", ":deg"))
"""A full turn, its name in messages, and the unit that `--angle` appends."""


def drop_incomplete_rows(table: Table, roles: Roles, config: DataConfig) -> tuple[list[int], list[str]]:
    """Return the complete rows, and sentences for the user.

    A complete row has a positive weight, and finite values of all columns that must be known. If states are measured in
    time, one finite state is enough: a missing value of a state removes only this value. Raises DataError if there are
    too few rows, or if a weight is negative or not a number. Also raises DataError if a used column is not finite in a
    row with a weight, unless the options allow dropping such rows.
    """
    _check_count(table, table.rows)
    weighted, unused = _weighted_rows(table, roles.weights)
    rows, dropped = _finite_rows(table, roles, weighted, config.missing == "drop")
    return rows, [*unused, *dropped, *_remarks(table, roles, rows, config)]


def _check_count(table: Table, count: int) -> None:
    if count < MIN_ROWS:
        rows = "row" if count == 1 else "rows"
        raise DataError(f"{table.files[0]} has {count} {rows} of data; at least {MIN_ROWS} are needed")


def check_searched_rows(table: Table, roles: Roles, rows: Sequence[int]) -> None:
    """Raise DataError if the search has too few `rows`, or if a column with an equation is constant in them."""
    _check_count(table, len(rows))
    for name in roles.derivatives or ((roles.target,) if roles.target is not None else roles.states):
        role = "state" if name in roles.states else "derivative" if roles.derivatives else "target"
        check_varies(table, name, table.column(name)[rows], role, is_only=len(roles.equations) == 1)


def check_sizes(columns: Mapping[str, FloatArray]) -> None:
    """Raise DataError if squares of the values of a column overflow or underflow. `columns` are by name; a column of
    zeros is allowed."""
    for name, column in columns.items():
        values = column[np.isfinite(column)]
        if values.any():
            check_size(name, float(np.abs(values).max()))


def check_size(name: str, size: float) -> None:
    """Raise DataError unless the square of `size`, the size of the values of `name`, is finite and above zero."""
    if not SMALLEST < size < 1.0 / SMALLEST:
        raise DataError(f"the values of '{name}' are too large or too small to compute with; choose another unit")


def check_rates(time: str, times: Sequence[FloatArray], states: Mapping[str, Sequence[FloatArray]], order: int) -> None:
    """Raise DataError if squares of time steps, or squares of a state's rates of change, overflow or underflow.

    `times` ascend strictly; `states` has values by name along the same trajectories; `order` is the order of the
    derivatives.
    """
    step = min((float(np.diff(part).min()) for part in times if len(part) > 1), default=1.0)
    step *= step if order == 2 else 1.0
    check_size(time, step)
    for name, parts in states.items():
        size = max((float(np.nanmax(np.abs(part))) for part in parts if np.isfinite(part).any()), default=0.0)
        if size:
            check_size(f"derivative of {name}", size / step)


def check_varies(table: Table, name: str, values: FloatArray, role: str, *, is_only: bool = False) -> None:
    """Raise DataError if a column that is a state, a derivative or the target has too few values, or is constant.

    `is_only`: this is the only column with an equation, so another choice of states does not help.
    """
    values = values[np.isfinite(values)]
    if len(values) < MIN_ROWS:
        count = f"{len(values)} {'value' if len(values) == 1 else 'values'}"
        raise DataError(f"{role} '{name}' of {table.files[0]} has {count}; at least {MIN_ROWS} are needed")
    if np.all(values == values[0]):
        value = f"{float(values[0]) + 0.0:g}"
        advice = "choose states with --states, or make it an input with --inputs" if role == "state" else "name another"
        advice = "add a column that varies" if role == "state" and is_only else advice
        raise DataError(f"{role} '{name}' of {table.files[0]} is constant ({value} in every row); {advice}")


def check_trajectory(table: Table, name: str, times: FloatArray, rows: Sequence[int], number: int) -> None:
    """Raise DataError unless trajectory `number` (from 1), at table rows `rows`, is long enough and its times ascend.

    `name` is the time column.
    """
    if len(times) > 1 and np.all(times == times[0]):
        raise DataError(f"the time column '{name}' is constant ({float(times[0]):g}); name another with --time")
    for row, (before, after) in zip(rows[1:], pairwise(times.tolist()), strict=True):
        if after == before:
            problem = f"time {table.moment(name, after)} is repeated at {table.places([row])}"
            raise DataError(f"{problem}; keep one row, or mark trajectories (--trajectory COLUMN or blank rows)")
        if after < before:
            moments = f"from {table.moment(name, before)} to {table.moment(name, after)}"
            problem = f"time goes back {moments} at {table.places([row])}"
            raise DataError(f"{problem}; sort the rows, or mark trajectories (--trajectory COLUMN or blank rows)")
    if len(rows) < MIN_ROWS:
        count = f"{len(rows)} {'row' if len(rows) == 1 else 'rows'}"
        place = table.places([rows[0]])
        raise DataError(
            f"trajectory {number}, which begins in {place}, has {count}; at least {MIN_ROWS} are needed: "
            "leave it out, or check what separates trajectories"
        )


def check_no_turns(name: str, parts: Sequence[FloatArray]) -> None:
    """Raise DataError if a state jumps by a full turn, as a wrapped angle does.

    The values of a wrapped angle are within one turn, and after subtraction of a full turn its jumps are as small as
    its other steps. A jump is larger than all other steps, whereas noise makes steps of all sizes. If there are few
    rows far apart, a step may be about a full turn by chance. The probability of this is estimated as a product. The
    first factor is the probability that a step reaches half a turn, if none of the n other steps does: 1/(n + 2)
    (Laplace's rule of succession). The second factor is the difference between step and full turn, as a share of a
    turn.
    """
    parts = [part[np.isfinite(part)] for part in parts]
    values = np.concatenate(parts)
    width = float(np.max(values)) - float(np.min(values))
    for turn, called, suffix in _TURNS:
        if not 0.5 * turn < width <= (1.0 + SETTINGS.common.negligible) * turn:
            continue
        steps = [np.diff(part) for part in parts]
        usual = max(float(np.max(np.abs(each)[np.abs(each) < 0.5 * turn], initial=0.0)) for each in steps)
        margins = [margin for each in steps for margin in _margins_of_turns(each, usual, turn)]
        others = sum(int(np.count_nonzero(np.abs(each) < 0.5 * turn)) for each in steps)
        mean = math.fsum(margins) / max(len(margins), 1)  # several jumps may have a common cause
        if margins and min(2.0 * mean / turn, 1.0) / (others + 2) <= SETTINGS.inference.improbable:
            count = f"{len(margins)} time{'s' if len(margins) > 1 else ''}"
            raise DataError(
                f"state '{name}' jumps by about {called} {count}, as a wrapped angle does; "
                f"add --angle {name}{suffix} so that it is unwrapped, or give it in another unit if it is not an angle"
            )


def _margins_of_turns(steps: FloatArray, usual: float, turn: float) -> list[float]:
    """Find the steps of about one `turn`. Return, for each, its difference from the neighbouring steps after
    subtraction of the turn.

    Such a step is much larger than the `usual` steps, and differs from the turn by little more than the steps next to
    it.
    """
    margins = []
    for index in np.flatnonzero(np.abs(steps) > max(0.5 * turn, _JUMP * usual)).tolist():
        step = float(steps[index])
        near = [float(steps[other]) for other in (index - 1, index + 1) if 0 <= other < len(steps)]
        near = [other for other in near if abs(other) < 0.5 * turn]
        around = max(map(abs, near), default=0.0)
        largest = min(_JUMP * around, usual)  # after subtraction of the turn the step is no larger than other steps
        if abs(abs(step) - turn) <= largest + SETTINGS.common.negligible * turn:
            rest = step - math.copysign(turn, step)
            margins.append(max((abs(rest - other) for other in near), default=usual))
    return margins


def _weighted_rows(table: Table, name: str | None) -> tuple[list[int], list[str]]:
    """Return the rows with a positive weight, and a sentence if rows are left out. Without a column of weights, return
    all rows."""
    if name is None:
        return [*range(table.rows)], []
    weights = table.column(name)
    bad = np.flatnonzero(~(np.isfinite(weights) & (weights >= 0.0))).tolist()
    if bad:
        value = float(weights[bad[0]])
        value_text = "an empty cell or NaN" if math.isnan(value) else f"{value:g}"
        raise DataError(
            f"the weights '{name}' hold {value_text} in {table.places(bad)}; a weight is a number from 0 (a row that "
            "is not used) up, such as 1/variance"
        )
    rows = np.flatnonzero(weights > 0.0).tolist()
    if len(rows) < MIN_ROWS:
        few = f"only {len(rows)} rows of {table.files[0]} have a weight above zero in '{name}'"
        raise DataError(f"{few}; at least {MIN_ROWS} are needed")
    count = table.rows - len(rows)
    return rows, [f"{count} of {table.rows} rows have no weight and are left out."] if count else []


def _finite_rows(table: Table, roles: Roles, weighted: list[int], drop: bool) -> tuple[list[int], list[str]]:
    """Return those of the rows `weighted` that have all needed values, and sentences if rows or values are left out.

    If states are measured in time, one finite state is enough; every other used column is needed.
    """
    used = [table.names.index(name) for name in roles.used]
    has_weight = np.isin(np.arange(table.rows), weighted)
    bad = ~np.isfinite(table.columns[used]) & has_weight
    if not bad.any():
        return weighted, []
    measured = () if roles.target is not None or roles.derivatives else roles.states
    is_state = np.array([name in measured for name in roles.used])
    is_lost = bad[~is_state].any(axis=0) | (bad[is_state].all(axis=0) & is_state.any())
    kept = np.flatnonzero(has_weight & ~is_lost).tolist()
    if not drop:
        few = [name for name, counts in zip(roles.used, (~bad[:, kept]).sum(axis=1), strict=True) if counts < MIN_ROWS]
        raise DataError(_missing_numbers_message(table, used, bad, _advice_on_missing(table, roles, bad, few)))
    if not kept:
        raise DataError(f"every row of {table.files[0]} holds NaN or infinity; no row is left to search")
    sentences = []
    if len(kept) < len(weighted):
        sentences.append(f"{len(weighted) - len(kept)} of {table.rows} rows hold NaN or infinity and were dropped.")
    counts = zip(bad[:, kept].sum(axis=1).tolist(), roles.used, strict=True)
    values = [f"{count} of {name}" for count, name in counts if count]
    if values:
        sentences.append(f"Values are missing, {' and '.join(values)}; their rows are used for the other states.")
    return kept, sentences


def _advice_on_missing(table: Table, roles: Roles, bad: BoolArray, few: Sequence[str]) -> str:
    """Return advice on missing numbers; the columns `few` would have too few values in the remaining rows."""
    if not few:
        return "correct them, or add --missing drop to leave them out"
    known = dict(zip(roles.used, (~bad).sum(axis=1).tolist(), strict=True))
    poor = min(known, key=lambda name: known[name])
    count = f"'{poor}' has {known[poor]} {'value' if known[poor] == 1 else 'values'} in {table.rows} rows"
    others = [name for name in roles.states if name != poor and name not in few]
    if poor in roles.states and others and not roles.derivatives:
        return f"{count}: leave it out with --states {','.join(others)}, or correct it"
    needed = f"{count}, and without these rows at least {MIN_ROWS} are needed: correct it"
    is_needed = poor == roles.time or tuple(roles.equations) == (poor,)
    return needed if is_needed else f"{needed}, or leave it out of the file"


def _missing_numbers_message(table: Table, used: Sequence[int], bad: BoolArray, advice: str) -> str:
    """Return the message: the first bad column and its rows, the number of all bad rows, and the advice."""
    names = [table.names[index] for index in used]
    first = int(np.argmax(bad.any(axis=1)))
    rows = np.flatnonzero(bad[first]).tolist()
    is_missing = bool(np.isnan(table.columns[used[first]][rows]).all())
    text = f"column '{names[first]}' holds {'NaN or an empty cell' if is_missing else 'NaN or infinity'}"
    text += f" in {table.places(rows)}"
    others = [name for name, bad_rows in zip(names, bad, strict=True) if bad_rows.any() and name != names[first]]
    if others:
        total = int(bad.any(axis=0).sum())
        text += f", and so do {', '.join(others)} ({total} rows in all)"
    return f"{text}; {advice}"


def _remarks(table: Table, roles: Roles, rows: list[int], config: DataConfig) -> list[str]:
    remarks = []
    if table.skipped:
        remarks.append(f"Columns of text or without a name are not used: {', '.join(table.skipped)}.")
    if table.left_out:
        remarks.append(f"Parts of the data were not read: {'; '.join(table.left_out)}.")
    if roles.target is not None and config.states is None and not config.inputs:
        left = [name for name in TIME_NAMES if name in table.names and name not in roles.used]
        remarks += [
            f"Column '{name}' is treated as the time and not used; add --inputs {name} to use it." for name in left
        ]
    degrees = [angle.column for angle in roles.angles if angle.degrees]
    if degrees:
        remarks.append(f"Degrees were converted to radians: {', '.join(degrees)}.")
    variables = [
        name
        for name in (*roles.states, *roles.inputs)
        if name not in (*roles.equations, *roles.observed) or roles.derivatives
    ]
    for name in variables:
        values = table.column(name)[rows]
        values = values[np.isfinite(values)]
        if len(values) and np.all(values == values[0]):
            remarks.append(f"Column '{name}' is constant: no equation can use it.")
    return remarks
