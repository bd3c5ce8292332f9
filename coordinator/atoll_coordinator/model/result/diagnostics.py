"""What a result says of smoothing: the noise of each state, its excluded rows, smoothed beside measured values."""

import math
from collections.abc import Mapping, Sequence
from typing import Final

from atoll_coordinator.data import recording as recordings
from atoll_coordinator.data.recording import ExcludedRow, Recording
from atoll_coordinator.model.refinement import StateErrors
from atoll_coordinator.model.result.numbers import curve, finite, thinned
from atoll_coordinator.result.findings import Errors, ExcludedRows, LargestResidual, Noise, Quantisation
from atoll_coordinator.result.listed_trajectories import Smoothed, Smoothing
from atoll_core.data.dataset import FloatArray

MOST_ROWS: Final = 2_000
"""Rows listed of each state, all trajectories together; of more, rows spread evenly."""
MOST_NUMBERS: Final = 100_000
"""Numbers listed in all, about 1 MB as text."""
LEAST_ROWS: Final = 2
"""Rows listed of each trajectory at least, its first and its last."""
MOST_EXCLUDED: Final = 2_000
"""Excluded rows of a state that are listed by their times."""


def noise(recording: Recording | None, errors: Mapping[str, StateErrors]) -> dict[str, Noise]:
    """Return what is known of the measurement errors of each state; empty when no state was measured in time.

    `errors` are what the residuals of the shown model say of them, by state.
    """
    if recording is None:
        return {}
    return {
        known.state: _noise(recording, index, known, errors.get(known.state))
        for index, known in enumerate(recording.smoothing)
    }


def _errors(errors: StateErrors | None) -> Errors | None:
    if errors is None:
        return None
    return Errors(
        sd=finite(errors.sd),
        proportional=errors.proportional,
        correlated=errors.correlated,
        correlation_rows=finite(errors.rows),
        independent_rows=finite(errors.independent_rows),
        add_up=errors.are_summed,
        piece=errors.piece,
    )


def _noise(recording: Recording, index: int, known: recordings.Smoothing, errors: StateErrors | None) -> Noise:
    longest = max((len(part.times) for part in recording.trajectories), default=None)
    rms, largest = _residuals(recording, index)
    return Noise(
        sd=finite(known.noise),
        relative=finite(known.relative_noise),
        method=known.method,
        span=known.span if known.span is None or longest is None else min(known.span, longest),
        degree=known.degree,
        quantisation=_quantisation(known.quantisation),
        residual_rms=rms,
        largest_residual=largest,
        doubtful_rows=known.uncertain_rows,
        outliers=known.outliers,
        doubtful=_excluded(recording, known.excluded_rows),
        errors=_errors(errors),
    )


def _quantisation(known: recordings.Quantisation | None) -> Quantisation | None:
    if known is None:
        return None
    return Quantisation(kind=known.kind, step=finite(known.step), error=finite(known.error))


def _residuals(recording: Recording, index: int) -> tuple[float | None, LargestResidual | None]:
    """Return the root mean square of measured minus smoothed values of one state, and where it is largest."""
    residuals = [
        (residual, part.name, time)
        for part in recording.trajectories
        if not part.held_out
        for residual, time in zip(
            (part.measured[index] - part.smoothed[index]).tolist(), part.times.tolist(), strict=True
        )
        if math.isfinite(residual)
    ]
    value, name, time = max(residuals, key=lambda residual: abs(residual[0]), default=(0.0, "", 0.0))
    squares = sum(residual * residual for residual, *_ in residuals)
    rms = finite(math.sqrt(squares / len(residuals))) if residuals else None
    if not value:
        return rms, None
    return rms, LargestResidual(value=finite(value), trajectory=name, time=_rounded(time + recording.offset))


def _rounded(time: float) -> float:
    return float(f"{time:.12g}")


def _excluded(recording: Recording, rows: Sequence[ExcludedRow]) -> tuple[ExcludedRows, ...]:
    """Return the times of excluded rows by trajectory and reason, each list in order."""
    lists: dict[tuple[int, str], list[float]] = {}
    for row in rows[:MOST_EXCLUDED]:
        time = float(recording.trajectories[row.trajectory].times[row.row])
        lists.setdefault((row.trajectory, row.reason), []).append(_rounded(time + recording.offset))
    return tuple(
        ExcludedRows(trajectory=recording.trajectories[number].name, reason=reason, times=tuple(times))
        for (number, reason), times in lists.items()
    )


def smoothing(recording: Recording | None) -> Smoothing | None:
    """Return smoothed beside measured values of the states that were smoothed; None when none was.

    `rows` counts all rows, `listed` those that are here: all of them, or rows of each trajectory spread evenly.
    """
    if recording is None:
        return None
    chosen = [index for index, known in enumerate(recording.smoothing) if known.method != "interpolation"]
    if not chosen:
        return None
    lists = _listed(recording, MOST_NUMBERS // (1 + 3 * len(chosen)))
    return Smoothing(
        rows=sum(len(part.times) for part in recording.trajectories),
        listed=sum(map(len, lists)),
        trajectories=tuple(
            Smoothed(
                name=part.name,
                held_out=part.held_out,
                times=curve(part.times[rows] + recording.offset, digits=12),
                measured=_values(recording, chosen, part.measured, rows),
                smoothed=_values(recording, chosen, part.smoothed, rows),
                residuals=_values(recording, chosen, part.measured - part.smoothed, rows),
            )
            for part, rows in zip(recording.trajectories, lists, strict=True)
        ),
    )


def _listed(recording: Recording, most: int) -> list[list[int]]:
    """Return the rows of each trajectory that are listed, at most so many and `MOST_ROWS` together."""
    rows, most = sum(len(part.times) for part in recording.trajectories), min(MOST_ROWS, most)
    counts = [len(part.times) for part in recording.trajectories]
    return [thinned(count, max(LEAST_ROWS, count * most // rows) if rows > most else count) for count in counts]


def _values(
    recording: Recording, chosen: list[int], values: FloatArray, rows: list[int]
) -> dict[str, tuple[float | None, ...]]:
    return {recording.states[index]: curve(values[index, rows]) for index in chosen}
