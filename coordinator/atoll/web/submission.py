"""Files and options as a page sends them: read, outlined, prepared for a look, made into a job.

A file is bytes under the name that it had, several are one after the other; options are those of the command line by
name.
"""

import json
import shlex
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any, Final

import numpy as np

from atoll.client.configure import configure
from atoll.client.options import GROUPS, OPTIONS, Repeated
from atoll.web.progress import some
from atoll_coordinator.data.outline import outline
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.data.reading.files import read_table
from atoll_coordinator.data.recording import Preparation, Recording, Trajectory
from atoll_coordinator.data.roles.roles import Roles, assign_roles
from atoll_coordinator.data.table_summary import describe
from atoll_core.config import JobConfig
from atoll_core.data.table import Table
from atoll_core.errors import UsageError

TABLE: Final = "application/vnd.atoll.table"
"""Content of a table that was read already, as clients of the bus upload it."""

PREVIEWED: Final = 500
"""Rows that are drawn of a trajectory at most."""

SHOWN: Final = 5

TRAJECTORIES: Final = 20
"""Of so many trajectories curves are drawn: with more a page would be longer than most tables."""


@dataclass(frozen=True)
class Submission:
    """Data and configuration of a job; `options` are as they were given."""

    filenames: tuple[str, ...]
    table: Table
    config: JobConfig
    options: Mapping[str, Any]

    @classmethod
    def of(cls, files: Mapping[str, bytes], options: str, media_type: str = "") -> "Submission":
        """Return what was sent: files by name, in order.

        Raises:
            UsageError: an option is unknown or does not fit; the name of a file is none.
            DataError: a file cannot be read.
        """
        given = _options(options)
        values = {name: Repeated(value) if isinstance(value, list) else value for name, value in given.items()}
        config = configure(values)
        if media_type == TABLE:
            table = Table.from_bytes(b"".join(files.values()))
            return cls(table.files or tuple(files), table, config, given)
        with tempfile.TemporaryDirectory(prefix="atoll-web-") as folder:
            paths = [Path(folder) / _plain(name) for name in files]
            if len({*paths}) < len(paths):
                raise UsageError("two files have the same name; send them under different ones")
            for path, body in zip(paths, files.values(), strict=True):
                path.write_bytes(body)
            return cls(tuple(path.name for path in paths), read_table(paths, config.data), config, given)

    def outlined(self) -> dict[str, Any]:
        """Return how the file was read and what would be searched, as plain data."""
        roles, _ = assign_roles(self.table, self.config.data)
        plan = outline(self.table, self.config).as_dict()
        angles = {angle.column: "degrees" if angle.degrees else "radians" for angle in roles.angles}
        units = plan["units"]
        assert isinstance(units, dict)
        return {
            **plan,
            "read_as": describe(self.table, self.config),
            "columns": [
                {
                    "name": name,
                    "role": _role(name, roles),
                    "unit": units.get(name),
                    "angle": angles.get(name),
                    "first": [f"{value:.6g}" for value in values[:SHOWN]],
                }
                for name, values in zip(self.table.names, self.table.columns, strict=True)
            ],
            "command": self.command(),
            "python": self.python(),
        }

    def command(self) -> str:
        """Return the command line that submits the same."""
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
        """Return the lines of Python that submit the same."""
        given = "".join(f", {name}={value!r}" for name, value in self.options.items())
        files = repr(self.filenames[0] if len(self.filenames) == 1 else [*self.filenames])
        return f"import atoll\n\nmodel = atoll.discover({files}{given})\nprint(model)"

    def prepared(self) -> dict[str, Any]:
        """Return what is measured, smoothed and differentiated, with standard errors; takes seconds."""
        return preview_of(prepare(self.table, self.config))


def preview_of(preparation: Preparation) -> dict[str, Any]:
    """Return the curves of the first trajectories of a preparation, decimated; none where nothing was differentiated.

    `sigma` and `derivative_sigma` are standard errors: of one measurement, and of the derivative, None where unknown.
    """
    recording, source = preparation.recording, preparation.source
    trajectories = recording.trajectories[:TRAJECTORIES] if recording is not None else ()
    curves = [_curves(recording, trajectory) for trajectory in trajectories if recording is not None]
    return {"time_name": source.time if source is not None else None, "trajectories": curves}


def _curves(recording: Recording, trajectory: Trajectory) -> dict[str, Any]:
    rows = some(len(trajectory.times), PREVIEWED)
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


def options_by_heading() -> dict[str, Any]:
    """Return the options of a job with their help, by heading."""
    return {
        "groups": {
            heading: [
                {
                    "name": option.name,
                    "flag": option.flag,
                    "metavar": option.metavar,
                    "help": option.help,
                    "is_repeatable": option.is_repeatable,
                }
                for option in options
            ]
            for heading, options in GROUPS.items()
        }
    }


def _options(text: str) -> dict[str, Any]:
    """Return options by name; raises UsageError."""
    try:
        given = json.loads(text or "{}")
    except (ValueError, RecursionError):
        raise UsageError('options must be a JSON object, such as {"seed": "3"}') from None
    if not isinstance(given, dict):
        raise UsageError('options must be a JSON object, such as {"seed": "3"}')
    for name, value in given.items():
        if name not in OPTIONS:
            raise UsageError("%s is no option of a job", name[:64])
        texts = value if isinstance(value, list) else [value]
        if not all(isinstance(part, (str, bool, int, float)) for part in texts):
            raise UsageError("the option %s must be a text, true, or a list of texts", name)
    return {name: value for name, value in given.items() if value not in (False, "", [])}


def _plain(name: str) -> str:
    """Return the name of a file without folders; raises UsageError where that is none."""
    plain = PurePath(name.replace("\\", "/")).name
    if not plain or plain in (".", "..") or len(plain.encode()) > 200 or not plain.isprintable():
        raise UsageError("the name of a file must be printable and have at most 200 bytes, such as data.csv")
    return plain


def _role(name: str, roles: Roles) -> str:
    single = {"time": roles.time, "trajectory": roles.trajectory, "target": roles.target, "weights": roles.weights}
    several = {"state": roles.states, "input": roles.inputs, "derivative": roles.derivatives}
    found = [role for role, column in single.items() if column == name]
    found += [role for role, columns in several.items() if name in columns]
    return found[0] if found else "unused"


def _numbers(values: Any) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]
