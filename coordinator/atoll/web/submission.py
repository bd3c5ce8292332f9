"""Reads the files and options of a page, for an outline and a preview. Only `reading_process` uses this module."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from atoll.client.job_options import OPTIONS
from atoll.web.page_options import read_options
from atoll.web.pictures import some
from atoll.web.reading_task import TABLE
from atoll_coordinator.data.outline import Outline, describe, outline
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.data.reading.files import read_table
from atoll_coordinator.data.reading.typed_formats import check_sheet
from atoll_coordinator.data.recording import Preparation, Recording, Trajectory
from atoll_coordinator.data.roles.roles import Roles
from atoll_core.config import JobConfig
from atoll_core.data.table import Table

PREVIEWED: Final = 500
"""Maximum number of rows of a trajectory in a preview."""

VALUES: Final = 50_000
"""Maximum number of values of a table in a preview, about a megabyte."""

SHOWN: Final = 5

TRAJECTORIES: Final = 20
"""Maximum number of trajectories in a preview; with more, the page would be longer than most tables."""


@dataclass(frozen=True)
class Submission:
    """Data and configuration of a job; `options` are the options that the page has sent."""

    filenames: tuple[str, ...]
    table: Table
    config: JobConfig
    options: Mapping[str, Any]

    @classmethod
    def of(cls, paths: Sequence[Path], options: str, media_type: str = "") -> "Submission":
        """Read the files; the endings of their names give the formats.

        Raises:
            UsageError: an option is unknown or does not fit.
            DataError: a file cannot be read.
        """
        sent, config = read_options(options)
        if media_type != TABLE:
            check_sheet(paths, config.data.sheet)
            return cls(tuple(path.name for path in paths), read_table(paths, config.data), config, sent)
        table = Table.from_bytes(paths[0].read_bytes())
        return cls(table.files, table, config, sent)

    def outline(self) -> dict[str, Any]:
        """Return how the file was read and which equations would be searched, as plain data."""
        planned = outline(self.table, self.config)
        return {
            **planned.as_dict(),
            "read_as": describe(self.table, self.config),
            "columns": self.columns(planned),
            "command": self.command(),
            "python": self.python(),
        }

    def columns(self, planned: Outline | None = None) -> list[dict[str, Any]]:
        """Return the columns of the table with their first values, as plain data; roles are null without an outline."""
        roles = None if planned is None else planned.roles
        angles = (
            {} if roles is None else {angle.column: "degrees" if angle.degrees else "radians" for angle in roles.angles}
        )
        units = {} if planned is None else planned.units
        first = {
            name: [_cell(self.table, name, value) for value in values[:SHOWN].tolist()]
            for name, values in zip(self.table.names, self.table.columns, strict=True)
        }
        return [
            {
                "name": name,
                "role": None if roles is None else _role(name, roles),
                "unit": units.get(name),
                "angle": angles.get(name),
                "first": first.get(name, []),
            }
            for name in (*self.table.names, *self.table.skipped)
        ]

    def command(self) -> str:
        """Return the command line of the same job."""
        words = ["coordinator", "submit", *self.filenames]
        for name, value in self.options.items():
            flag = OPTIONS[name].flag
            if value is True:
                words.append(flag)
            else:
                for text in value if isinstance(value, list) else [value]:
                    words += [flag, str(text)]
        return shlex.join(words)

    def python(self) -> str:
        """Return the Python code of the same job."""
        given = "".join(f", {name}={value!r}" for name, value in self.options.items())
        files = repr(self.filenames[0] if len(self.filenames) == 1 else [*self.filenames])
        return f"import atoll\n\nmodel = atoll.discover({files}{given})\nprint(model)"

    def preview(self) -> dict[str, Any]:
        """Return measured values, and smoothed values and derivatives with standard errors; this takes seconds."""
        return preview_of(prepare(self.table, self.config))


def preview_of(preparation: Preparation) -> dict[str, Any]:
    """Return thinned curves of the first trajectories of a preparation; no curves if no derivative was estimated.

    `sigma` and `derivative_sigma` are the standard errors of a measurement and of the derivative; None: unknown.
    """
    recording, source = preparation.recording, preparation.source
    trajectories = recording.trajectories[:TRAJECTORIES] if recording is not None else ()
    most = VALUES // max(1, 3 * sum(len(trajectory.measured) for trajectory in trajectories))
    curves = [_curves(recording, trajectory, most) for trajectory in trajectories if recording is not None]
    return {"time_name": source.time if source is not None else None, "trajectories": curves}


def _curves(recording: Recording, trajectory: Trajectory, most: int) -> dict[str, Any]:
    rows = some(len(trajectory.times), max(SHOWN, min(PREVIEWED, most)))
    rates = trajectory.rates if trajectory.rates is not None else trajectory.slopes
    errors = trajectory.rate_errors if trajectory.rate_errors is not None else np.full_like(rates, np.nan)
    return {
        "name": trajectory.name,
        "time": _numbers(trajectory.times[rows] + recording.offset),
        "states": [
            {
                "name": name,
                "measured": _numbers(trajectory.measured[place, rows]),
                "smoothed": _numbers(trajectory.smoothed[place, rows]),
                "sigma": recording.smoothing[place].noise,
                "derivative": _numbers(rates[place, rows]),
                "derivative_sigma": _numbers(errors[place, rows]),
            }
            for place, name in enumerate(recording.states)
        ],
    }


def _role(name: str, roles: Roles) -> str:
    single = {"time": roles.time, "trajectory": roles.trajectory, "target": roles.target, "weights": roles.weights}
    several = {"state": roles.states, "input": roles.inputs, "derivative": roles.derivatives}
    found = [role for role, column in single.items() if column == name]
    found += [role for role, columns in several.items() if name in columns]
    return found[0] if found else "unused"


def _cell(table: Table, name: str, value: float) -> str:
    """Return a value as in the file: a text, a date, or a number with six significant digits."""
    text = table.label(name, value)
    if text is not None:
        return text
    return table.moment(name, value).removesuffix(" 00:00:00") if name in table.origins else f"{value:.6g}"


def _numbers(values: Any) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]
