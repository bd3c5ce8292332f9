"""What a result says of smoothing: the noise of each state, its excluded rows, smoothed beside measured values.

Plain dictionaries, lists, texts and numbers for ``result.json``; a number that is not known or not finite is null.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

from atoll_coordinator.data.recording import ExcludedRow, Quantisation, Recording, Smoothing
from atoll_coordinator.model.refinement import StateErrors
from atoll_coordinator.model.result.numbers import curve, finite, thinned
from atoll_core.data.dataset import FloatArray

MOST_ROWS: Final = 2_000
"""Rows listed of each state, all trajectories together; of more, rows spread evenly."""
MOST_NUMBERS: Final = 100_000
"""Numbers listed in all, about 1 MB as text."""
LEAST_ROWS: Final = 2
"""Rows listed of each trajectory at least, its first and its last."""
MOST_EXCLUDED: Final = 2_000
"""Excluded rows of a state that are listed by their times."""


def noise(recording: Recording | None, errors: Mapping[str, StateErrors]) -> dict[str, Any]:
    """Return what is known of the measurement errors of each state; empty when no state was measured in time.

    `errors` are what the residuals of the shown model say of them, by state.
    """
    if recording is None:
        return {}
    return {
        each.state: {**_noise(recording, index, each), "errors": _errors(errors.get(each.state))}
        for index, each in enumerate(recording.smoothing)
    }


def _errors(its: StateErrors | None) -> dict[str, Any] | None:
    if its is None:
        return None
    return {
        "sd": finite(its.sd),
        "proportional": its.proportional,
        "correlated": its.correlated,
        "correlation_rows": None if its.rows is None else finite(its.rows),
        "independent_rows": finite(its.independent_rows),
        "add_up": its.are_summed,
        "piece": its.piece,
    }


def _noise(recording: Recording, index: int, its: Smoothing) -> dict[str, Any]:
    longest = max((len(each.times) for each in recording.trajectories), default=None)
    return {
        "sd": finite(its.noise),
        "relative": finite(its.relative_noise),
        "method": its.method,
        "span": its.span if its.span is None or longest is None else min(its.span, longest),
        "degree": its.degree,
        "quantisation": _quantisation(its.quantisation),
        **_residuals(recording, index),
        "doubtful_rows": its.uncertain_rows,
        "outliers": its.outliers,
        "doubtful": _excluded(recording, its.excluded_rows),
    }


def _quantisation(its: Quantisation | None) -> dict[str, Any] | None:
    return None if its is None else {"kind": its.kind, "step": finite(its.step), "error": finite(its.error)}


def _residuals(recording: Recording, index: int) -> dict[str, Any]:
    """Return the root mean square of measured minus smoothed values of one state, and where it is largest."""
    found = [
        (residual, its.name, time)
        for its in recording.trajectories
        if not its.held_out
        for residual, time in zip((its.measured[index] - its.smoothed[index]).tolist(), its.times.tolist(), strict=True)
        if math.isfinite(residual)
    ]
    value, name, time = max(found, key=lambda each: abs(each[0]), default=(0.0, "", 0.0))
    rms = math.sqrt(sum(residual * residual for residual, *_ in found) / len(found)) if found else 0.0
    largest = {"value": finite(value), "trajectory": name, "time": _rounded(time + recording.offset)}
    return {"residual_rms": finite(rms) if found else None, "largest_residual": largest if value else None}


def _rounded(time: float) -> float:
    return float(f"{time:.12g}")


def _excluded(recording: Recording, rows: Sequence[ExcludedRow]) -> list[dict[str, Any]]:
    """Return the times of excluded rows by trajectory and reason, each list in order."""
    found: dict[tuple[int, str], list[float]] = {}
    for each in rows[:MOST_EXCLUDED]:
        time = float(recording.trajectories[each.trajectory].times[each.row])
        found.setdefault((each.trajectory, each.reason), []).append(_rounded(time + recording.offset))
    return [
        {"trajectory": recording.trajectories[number].name, "reason": reason, "times": times}
        for (number, reason), times in found.items()
    ]


def smoothing(recording: Recording | None) -> dict[str, Any] | None:
    """Return smoothed beside measured values of the states that were smoothed; None when none was.

    `rows` counts all rows, `listed` those that are here: all of them, or rows of each trajectory spread evenly.
    """
    if recording is None:
        return None
    chosen = [index for index, its in enumerate(recording.smoothing) if its.method != "interpolation"]
    rows = sum(len(each.times) for each in recording.trajectories)
    if not chosen:
        return None
    most = min(MOST_ROWS, MOST_NUMBERS // (1 + 3 * len(chosen)))
    lists = [
        thinned(len(each.times), max(LEAST_ROWS, len(each.times) * most // rows) if rows > most else len(each.times))
        for each in recording.trajectories
    ]
    return {
        "rows": rows,
        "listed": sum(map(len, lists)),
        "trajectories": [
            {
                "name": each.name,
                "held_out": each.held_out,
                "times": curve(each.times[listed] + recording.offset, digits=12),
                "measured": _values(recording, chosen, each.measured, listed),
                "smoothed": _values(recording, chosen, each.smoothed, listed),
                "residuals": _values(recording, chosen, each.measured - each.smoothed, listed),
            }
            for each, listed in zip(recording.trajectories, lists, strict=True)
        ],
    }


def _values(recording: Recording, chosen: list[int], values: FloatArray, listed: list[int]) -> dict[str, Any]:
    return {recording.states[index]: curve(values[index, listed]) for index in chosen}
