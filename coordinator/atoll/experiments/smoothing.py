"""The states along each trajectory under the law of a result, with standard errors and bands.

The initial state of each trajectory is fitted, and the law is simulated from there. So a smoothed state uses all rows
of its trajectory, before and after it, and what is known of the constants. If one initial state does not describe a
trajectory up to its noise (chaos, or a law that misses an effect), the trajectory is divided into pieces, each with an
initial state of its own. The result lists the times at which pieces join: there the states have a small jump.

Doubtful: the bands are first-order, and they assume the law. Letters: D states, N rows of a trajectory.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from atoll.experiments.states import KnownLaw
from atoll.model.equations import LEVEL, quantile
from atoll.terminal.output import plain
from atoll_coordinator.model.shooting.measurements import TrajectoryMeasurements
from atoll_coordinator.result.result import Result
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.data.frames import FrameLibrary, csv_of, frame_of
from atoll_core.data.table import Table
from atoll_core.errors import AtollError
from atoll_core.quoting import first_lines

if TYPE_CHECKING:
    import polars

SCHEMA: Final = 1
_MOST_LISTED: Final = 10
"""Largest number of times in a sentence."""


@dataclass(frozen=True, eq=False)
class SmoothedTrajectory:
    """The states along one trajectory.

    Attributes:
        name: the name of the trajectory.
        t: the times of its rows (N,).
        x: the states (N, D), in the units of the data; angles are in radians. A state with an unknown offset includes
            it, as its column does.
        stderr: standard errors (N, D) from the errors of the initial state and of the constants.
        lower: lower ends (N, D) of the 95 % band.
        upper: upper ends (N, D).
        measured: measured values (N,) by state, NaN where a value is missing or not used.
        piece: the number of the piece (N,) of each row, from 1.
        joins: the times at which a new piece begins; empty if the trajectory has one piece.
        is_like_noise: whether the residuals are as large as the noise.
    """

    name: str
    t: FloatArray
    x: FloatArray
    stderr: FloatArray
    lower: FloatArray
    upper: FloatArray
    measured: Mapping[str, FloatArray]
    piece: FloatArray
    joins: tuple[float, ...]
    is_like_noise: bool

    @property
    def sentence(self) -> str:
        """A sentence about the pieces of the trajectory and its residuals."""
        listed = ", ".join(f"{time:.6g}" for time in self.joins[:_MOST_LISTED])
        listed += ", …" if len(self.joins) > _MOST_LISTED else ""
        text = f"trajectory {self.name}: one initial state for {len(self.t)} rows"
        if self.joins:
            text = f"trajectory {self.name}: {len(self.joins) + 1} pieces, which join at {listed}"
        return text if self.is_like_noise else f"{text}; the residuals exceed the noise, so the bands are too narrow"


@dataclass(frozen=True, eq=False)
class SmoothedStates:
    """The states along all trajectories under a law.

    `states` are the names of the D states; velocities follow the positions, and measured columns that are computed from
    states come last. `source` names the data. `time` is the name of the time column.
    """

    states: tuple[str, ...]
    trajectories: tuple[SmoothedTrajectory, ...]
    time: str
    source: str

    def __getitem__(self, name: object) -> SmoothedTrajectory:
        """Return a trajectory by name; raises KeyError."""
        found = next((part for part in self.trajectories if part.name == str(name)), None)
        if found is None:
            raise KeyError(name)
        return found

    def __str__(self) -> str:
        return "\n".join([f"states under the law along {self.source}", *self.sentences])

    def __repr__(self) -> str:
        return first_lines(str(self), "print it")

    @property
    def sentences(self) -> tuple[str, ...]:
        """A sentence about each trajectory."""
        return tuple(part.sentence for part in self.trajectories)

    def columns(self) -> dict[str, list[Any]]:
        """Return the rows of all trajectories by column: the name of the trajectory, the time, the number of the piece,
        and for each state its value, standard error, 95 % band and, if it was measured, its measured value."""
        parts = self.trajectories
        columns: dict[str, list[Any]] = {
            "trajectory": [part.name for part in parts for _ in part.t],
            self.time: [value for part in parts for value in part.t.tolist()],
            "piece": [int(value) for part in parts for value in part.piece.tolist()],
        }
        for place, state in enumerate(self.states):
            for suffix, of in (("", "x"), ("_stderr", "stderr"), ("_lower", "lower"), ("_upper", "upper")):
                columns[state + suffix] = [value for part in parts for value in getattr(part, of)[:, place].tolist()]
            if state in parts[0].measured:
                columns[f"{state}_measured"] = [value for part in parts for value in part.measured[state].tolist()]
        return columns

    def to_csv(self) -> str:
        """Return the columns as CSV; numbers have all digits, and missing values are empty."""
        columns = self.columns().items()
        return csv_of({name: ["" if value != value else value for value in values] for name, values in columns})

    def to_frame(self, library: FrameLibrary = "polars") -> "polars.DataFrame | Any":
        """Return the `columns` as a frame of ``"polars"`` or ``"pandas"``; raises UsageError without that library."""
        return frame_of(self.columns(), library)

    def as_dict(self) -> dict[str, object]:
        """Return plain data, as ``coordinator smooth --json`` prints it; unknown numbers are None."""
        parts = []
        for part in self.trajectories:
            curves = {"x": part.x, "stderr": part.stderr, "lower": part.lower, "upper": part.upper}
            by_state = {name: dict(zip(self.states, values.T, strict=True)) for name, values in curves.items()}
            parts.append(
                {"name": part.name, "joins": part.joins, "is_like_noise": part.is_like_noise, "times": part.t}
                | by_state
                | {"measured": part.measured}
            )
        return plain({"schema": SCHEMA, "source": self.source, "states": self.states, "trajectories": parts})


def smooth(result: Result, table: Table | None = None) -> SmoothedStates:
    """Return the states along the trajectories of a result, or along the trajectories of `table`.

    Raises:
        UsageError: the result is not a law of trajectories, or there are no measurements.
        DataError: the data have an error.
        AtollError: the law cannot be simulated along a trajectory.
    """
    law = KnownLaw.of(result, table)
    width = quantile(LEVEL, law.fitted.degrees_of_freedom)
    parts = tuple(_smoothed(law, name, part, width) for name, part in law.trajectories())
    return SmoothedStates(law.shown, parts, result.time, law.target.source)


def _smoothed(law: KnownLaw, name: str, trajectory: TrajectoryMeasurements, width: float) -> SmoothedTrajectory:
    found = law.fit_in_pieces(trajectory)
    if found is None:
        raise AtollError(
            f"the law cannot be simulated along trajectory {name}, not even along pieces of "
            f"{SETTINGS.shooting.lengths[0]} rows; give other data"
        )
    measurements, values = found.measurements, found.shown_values
    errors = found.shown_errors(law.fitted.root @ law.fitted.root.T)
    measured = np.where(measurements.weights > 0.0, measurements.measured, np.nan)
    lengths = measurements.bounds[:, 1] - measurements.bounds[:, 0]
    times = law.times_of(measurements)
    return SmoothedTrajectory(
        name=name,
        t=times,
        x=values.T,
        stderr=errors.T,
        lower=(values - width * errors).T,
        upper=(values + width * errors).T,
        measured=dict(zip(law.shown_columns(measurements), measured, strict=True)),
        piece=np.repeat(np.arange(1, len(lengths) + 1), lengths),
        joins=tuple(times[measurements.bounds[1:, 0]].tolist()),
        is_like_noise=found.is_like_noise,
    )
