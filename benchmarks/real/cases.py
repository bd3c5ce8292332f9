"""The jobs of real measurements: a file, the options with which a user would hand it over, and some of its rows."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from atoll_coordinator.data.reading.files import read_table
from atoll_core.config import JobConfig
from atoll_core.data.table import Table
from benchmarks.harness.jobs import configured, table_of_columns


@dataclass(frozen=True)
class Case:
    """A job: `file` in the folder of data, fields of the configuration's data section, and a range of its rows.

    `share` is the first and the last row, as shares of all. `operators` are those of the search, none the default ones.
    `shift` is subtracted from columns: what they are at rest. Of a file of arrays, `array` names the one (R, 3) that
    has the states x, y, z of rows 0.05 apart.
    """

    name: str
    file: str
    options: Mapping[str, Any] = field(default_factory=dict)
    share: tuple[float, float] = (0.0, 1.0)
    operators: tuple[str, ...] = ()
    shift: Mapping[str, float] = field(default_factory=dict)
    array: str | None = None

    def config(self, seed: int, max_time: float | None) -> JobConfig:
        """Return the configuration of the job."""
        return configured(seed, self.options, {"max_time": max_time}, self.operators or None)

    def table(self, folder: Path) -> Table:
        """Return the rows of the job; raises DataError where the file cannot be read."""
        if self.array is not None:
            states = np.load(folder / self.file)[self.array]
            times = np.asarray(0.05 * np.arange(len(states)), dtype=np.float64)
            return table_of_columns({"t": times, **dict(zip("xyz", states.T, strict=True))}, self.file)
        whole = self._shifted(read_table([folder / self.file], self.config(0, None).data))
        first, last = (round(share * whole.rows) for share in self.share)
        if (first, last) == (0, whole.rows):
            return whole
        rows = slice(first, last)
        starts = sorted({0, *(start - first for start in whole.starts if first < start < last)})
        return replace(
            whole,
            columns=np.ascontiguousarray(whole.columns[:, rows]),
            starts=tuple(starts),
            file_of_row=whole.file_of_row[rows],
            line_of_row=whole.line_of_row[rows],
        )

    def _shifted(self, table: Table) -> Table:
        columns = np.array(table.columns)
        for name, rest in self.shift.items():
            columns[table.names.index(name)] -= rest
        return replace(table, columns=columns)


_PENDULUM: Final = ("pendulum_small_swing.csv", {"order": 2})
_FRICTION: Final[Mapping[str, Any]] = {
    "operators": ("+", "-", "*", "/", "sin", "cos", "tanh"),
    "shift": {"theta": math.pi},
}
"""Dry friction is a hyperbolic tangent of a steep slope; a small swing is told by the angle from rest."""

CASES: Final = (
    Case("pendulum", *_PENDULUM),
    Case("pendulum, first half", *_PENDULUM, (0.0, 0.5)),
    Case("pendulum, second half", *_PENDULUM, (0.5, 1.0)),
    Case("small swing with tanh", *_PENDULUM, **_FRICTION),
    Case("small swing with tanh, first half", *_PENDULUM, (0.0, 0.5), **_FRICTION),
    Case("small swing with tanh, second half", *_PENDULUM, (0.5, 1.0), **_FRICTION),
    Case("Gause", "gause_paramecium.csv", {"trajectory": "run", "time": "day", "missing": "drop"}),
    Case("double pendulum", "double_pendulum.csv", {"trajectory": "run", "order": 2}),
    *(Case(f"contest {name}", "ctf_lorenz_train.npz", array=name) for name in ("X1", "X2", "X3")),
)
"""A real pendulum near its rest position, whole and by halves, as measured and with dry friction; three runs of
Paramecium; a double pendulum; Lorenz's equations as a contest has them, without noise and with two sizes of it."""
