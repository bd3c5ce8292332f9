"""What a check of columns sees, and what it finds. Pure data."""

import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from atoll_coordinator.data.roles.roles import Roles
from atoll_coordinator.data.trajectories.measurements import Measurements
from atoll_core.config import JobConfig
from atoll_core.data.dataset import FloatArray

Parts = Sequence[FloatArray]
"""The values of a column along each trajectory, NaN where they are missing."""


@dataclass(frozen=True)
class Finding:
    """What was `found` in the columns, and the `advice` what to do, both without a stop at the end.

    It is acted on where that is safe: the states `left_out` are not sought, and the values `missing`, by column, are
    taken as missing.
    """

    found: str
    advice: str
    left_out: tuple[str, ...] = ()
    missing: tuple[tuple[str, float], ...] = ()

    @property
    def sentence(self) -> str:
        """What is said."""
        return f"{self.found}; {self.advice}."


@dataclass(frozen=True, eq=False)
class Columns:
    """The variables of a job along the trajectories that are not held out, by column.

    `values` has states, inputs and the target; angles are unwrapped.
    """

    roles: Roles
    config: JobConfig
    times: Parts
    values: Mapping[str, Parts]

    @classmethod
    def of(cls, measurements: Measurements, config: JobConfig) -> "Columns":
        """Return what checks see of measurements."""
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
        """Columns that are angles, whose values are not those of the file."""
        return frozenset(angle.column for angle in self.roles.angles)

    @cached_property
    def whole(self) -> Mapping[str, FloatArray]:
        """The values of each column over all trajectories (R,)."""
        return {name: np.concatenate(list(parts)) for name, parts in self.values.items()}

    def finite(self, name: str) -> FloatArray:
        """Return all values of a column that are there."""
        values = self.whole[name]
        return values[np.isfinite(values)]

    def may_leave_out(self, name: str) -> bool:
        """Say whether a column is a state that no option names, so that it may be left out."""
        data = self.config.data
        if not self.is_in_time or name not in self.roles.states or data.states is not None:
            return False
        named = {*(data.only or ()), *data.offsets, *self.angles, data.group, data.trajectory}
        texts = self.config.model_dump_json(include={"space", "prior"}, exclude_defaults=True)
        return name not in named and re.search(rf"(?<!\w){re.escape(name)}(?!\w)", texts) is None

    def without(self, missing: Mapping[str, float]) -> "Columns":
        """Return the same with one value of some columns taken as missing."""
        values = {
            name: [np.where(part == missing[name], np.nan, part) for part in parts] if name in missing else parts
            for name, parts in self.values.items()
        }
        return Columns(self.roles, self.config, self.times, values)


def listed(names: Iterable[str]) -> str:
    """Return column names as an option takes them, in quotes where the shell needs them."""
    return shlex.quote(",".join(f'"{name}"' if "," in name else name for name in names))
