"""The input of a check of columns, its output, and sums of a few thousand numbers in a fixed order. Pure."""

import math
import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from atoll_coordinator.data.roles.roles import Roles
from atoll_coordinator.data.trajectories.measurements import Measurements
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import JobConfig
from atoll_core.data.dataset import FloatArray

Parts = Sequence[FloatArray]
"""The values of a column along each trajectory, NaN where they are missing."""


@dataclass(frozen=True)
class ColumnFinding:
    """A result of a check: the text `found` and the `advice`, both without a full stop.

    `left_out` are states whose equations are not searched. `missing` has pairs of a column and a value; in this column,
    the value is treated as missing.
    """

    found: str
    advice: str
    left_out: tuple[str, ...] = ()
    missing: tuple[tuple[str, float], ...] = ()

    @property
    def sentence(self) -> str:
        """The message."""
        return f"{self.found}; {self.advice}."


@dataclass(frozen=True, eq=False)
class ExaminedColumns:
    """The variables of a job along the trajectories that are not held out, by column.

    `values` has states, inputs and the target; angles are unwrapped.
    """

    roles: Roles
    config: JobConfig
    times: Parts
    values: Mapping[str, Parts]

    @classmethod
    def of(cls, measurements: Measurements, config: JobConfig) -> "ExaminedColumns":
        """Return the examined columns of measurements."""
        roles, whole = measurements.roles, measurements.trajectories
        kept = [place for place, is_out in enumerate(measurements.held_out) if not is_out]
        parts = {
            name: [measurements.columns[name][first:last] for first, last in measurements.ranges]
            for name in dict.fromkeys((*roles.variables, *roles.equations))
            if name in measurements.columns
        }
        parts |= {name: list(along) for name, along in zip(roles.inputs, measurements.inputs, strict=True)}
        if whole is not None:
            parts |= {name: list(along) for name, along in whole.states.items()}
        finite = {
            name: [np.where(np.isfinite(along[place]), along[place], np.nan) for place in kept]
            for name, along in parts.items()
        }
        times = [] if whole is None else [whole.times[place] for place in kept]
        return cls(roles, config, times, finite)

    @property
    def is_in_time(self) -> bool:
        """Whether states are measured in time and differentiated."""
        return bool(self.times)

    @property
    def angles(self) -> frozenset[str]:
        """Columns that are angles; their values were unwrapped and differ from the values of the file."""
        return frozenset(angle.column for angle in self.roles.angles)

    @cached_property
    def whole(self) -> Mapping[str, FloatArray]:
        """The values of each column over all trajectories (R,)."""
        return {name: np.concatenate(list(parts)) for name, parts in self.values.items()}

    def finite(self, name: str) -> FloatArray:
        """Return all values of a column that are not missing."""
        values = self.whole[name]
        return values[np.isfinite(values)]

    def may_leave_out(self, name: str) -> bool:
        """Tell whether a column may be left out: it is a state that no option names."""
        data = self.config.data
        if not self.is_in_time or name not in self.roles.states or data.states is not None:
            return False
        named = {*(data.only or ()), *data.offsets, *self.angles, data.group, data.trajectory}
        texts = self.config.model_dump_json(include={"space", "prior"}, exclude_defaults=True)
        return name not in named and re.search(rf"(?<!\w){re.escape(name)}(?!\w)", texts) is None

    def without(self, missing: Mapping[str, float]) -> "ExaminedColumns":
        """Return the columns; in each column of `missing`, one value is treated as missing."""
        values = {
            name: [np.where(part == missing[name], np.nan, part) for part in parts] if name in missing else parts
            for name, parts in self.values.items()
        }
        return ExaminedColumns(self.roles, self.config, self.times, values)


def listed(names: Iterable[str]) -> str:
    """Return column names in the form of an option's value, in quotes if the shell needs them."""
    return shlex.quote(",".join(f'"{name}"' if "," in name else name for name in names))


def quoted(names: Iterable[str]) -> str:
    """Return column names for a sentence: 'x' and 'y'."""
    return " and ".join(f"'{name}'" for name in names)


def dot(one: FloatArray, other: FloatArray) -> float:
    """Return the sum of products."""
    return math.fsum((one * other).tolist())


def mean(values: FloatArray) -> float:
    """Return the mean; 0 for no values."""
    return math.fsum(values.tolist()) / max(1, len(values))


def variance(values: FloatArray) -> float:
    """Return the variance: the mean squared distance from the mean."""
    away = values - mean(values)
    return dot(away, away) / max(1, len(away))


def upper_median(values: FloatArray) -> float:
    """Return the upper median; 0 for no values."""
    return float(np.sort(values)[len(values) // 2]) if len(values) else 0.0


def roughness(parts: Parts) -> float:
    """Return half of the mean squared step from row to row, divided by the variance (von Neumann 1941); NaN is ignored.

    It is 1 for white noise, and small for smooth motion: 1 - cos(2 pi / n) for a wave with n rows in a period.
    """
    begin = [part[: SETTINGS.rows.in_sums] for part in parts]
    steps = np.concatenate([np.diff(part) for part in begin])
    values = np.concatenate(begin)
    steps, values = steps[np.isfinite(steps)], values[np.isfinite(values)]
    spread = variance(values)
    return 0.5 * dot(steps, steps) / (max(1, len(steps)) * spread) if spread > 0.0 else 0.0
