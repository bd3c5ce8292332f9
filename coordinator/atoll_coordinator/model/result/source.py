"""What a result says of where it comes from: the data, what their columns are, the settings."""

from typing import Final

import numpy as np
from pydantic import JsonValue

from atoll_coordinator.data.recording import Preparation, Recording, Source, Trajectory
from atoll_coordinator.model.result.numbers import curve, thinned
from atoll_coordinator.result.findings import Data, Kind, System
from atoll_coordinator.result.listed_trajectories import Recorded
from atoll_core.config import JobConfig
from atoll_core.data.dataset import FloatArray

MOST_ROWS: Final = 2_000
"""Rows listed, all trajectories together; of more, rows spread evenly."""
MOST_NUMBERS: Final = 100_000
"""Numbers listed in all, about 1 MB as text."""
LEAST_ROWS: Final = 8
"""Rows listed of each trajectory at least."""
DIGITS: Final = 12
"""Significant digits of what was measured: errors of less than 1e-11 of a value are none."""


def data(given: Preparation, *, has_trajectories: bool = True) -> Data | None:
    """Return digest, files and number of rows of the table, how it was read, and what was measured of each trajectory.

    None where the source is not known. `trajectories` is null where states were not measured in time, or not wanted.
    """
    source = given.source
    if source is None:
        return None
    listed = None if given.recording is None or not has_trajectories else _trajectories(given.recording)
    return Data(digest=source.digest, files=source.files, rows=source.rows, read_as=source.read_as, trajectories=listed)


def _trajectories(recording: Recording) -> tuple[Recorded, ...]:
    rows = sum(len(part.times) for part in recording.trajectories)
    most = min(MOST_ROWS, MOST_NUMBERS // (1 + len(recording.states) + 2 * len(recording.inputs)))
    return tuple(_trajectory(recording, part, min(1.0, most / max(rows, 1))) for part in recording.trajectories)


def _trajectory(recording: Recording, part: Trajectory, share: float) -> Recorded:
    """Return one trajectory as it was measured, a `share` of its rows; weights are null where all are 1."""
    count = len(part.times)
    listed = thinned(count, max(LEAST_ROWS, int(share * count)))
    if len(listed) < count:
        listed = sorted({*listed, *_switches(part)[:MOST_ROWS]})
    robust = part.robustness_weights
    return Recorded(
        name=part.name,
        held_out=part.held_out,
        rows=count,
        times=curve(part.times[listed] + recording.offset, DIGITS),
        measured=_by_name(recording.states, part.measured, listed),
        inputs=_by_name(recording.inputs, part.inputs, listed),
        input_slopes=_by_name(recording.inputs, part.input_slopes, listed),
        weights=None if part.weights is None else curve(part.weights[listed], DIGITS),
        robustness_weights=None if robust is None else _by_name(recording.states, robust, listed),
    )


def _switches(part: Trajectory) -> list[int]:
    """Return the rows at which a held input changes: left out, the value before would last too long."""
    held = part.inputs[np.isnan(part.input_slopes).any(axis=1)]
    return (np.flatnonzero((held[:, 1:] != held[:, :-1]).any(axis=0)) + 1).tolist()


def _by_name(names: tuple[str, ...], values: FloatArray, listed: list[int]) -> dict[str, tuple[float | None, ...]]:
    return {name: curve(np.asarray(row[listed]), DIGITS) for name, row in zip(names, values, strict=True)}


def system(given: Preparation) -> System | None:
    """Return what the columns are, their units, and the range of each variable in the rows that count.

    All by column name; angles are in radians there. None where the source is not known.
    """
    source = given.source
    if source is None:
        return None
    dataset = given.counted or given.dataset
    ranges = zip(dataset.symbols, dataset.inputs, strict=True)
    recording = given.recording
    return System(
        kind=_kind(given, source),
        order=source.order,
        time=source.time,
        states=source.states,
        velocities=source.velocities,
        inputs=source.inputs,
        input_kinds={} if recording is None else dict(zip(recording.inputs, recording.input_kinds, strict=False)),
        target=source.target,
        units=dict(source.units),
        ranges={name: (float(values.min()), float(values.max())) for name, values in ranges},
    )


def _kind(given: Preparation, source: Source) -> Kind:
    if source.target is not None:
        return "regression"
    return "process" if given.process is not None else "dynamics"


def settings(config: JobConfig) -> dict[str, JsonValue]:
    """Return the settings that are not the preset's defaults, as a job file has them."""
    return config.model_dump(mode="json", exclude_defaults=True)
