"""Paths of a process: normal steps with the mean and the covariance of `moments`, those that constants are fitted by.

Letters: S states, U inputs, N steps or times, P paths.
"""

import csv
import io
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from atoll_coordinator.stochastic.moments import StepMoments
from atoll_core.data.dataset import FloatArray
from atoll_core.data.frames import FrameLibrary, frame_of

if TYPE_CHECKING:
    import polars

PATHS: Final = 256
"""Of an ensemble: means are known to a sixteenth of the spread of the paths."""
SHARES: Final = (0.05, 0.5, 0.95)
"""Of the paths that lie below `lower`, `median` and `upper`."""
_SLACK: Final = 1e-9
"""Share of a step by which rounding may make a gap between two times longer."""


@dataclass(frozen=True, eq=False)
class Simulator:
    """Draws paths of the process whose steps of given lengths (P,) from points (S + U, P) have these `moments`."""

    moments: Callable[[FloatArray, FloatArray], StepMoments]
    random: np.random.Generator

    def paths(
        self,
        starts: FloatArray,
        inputs: FloatArray,
        lengths: FloatArray,
        is_kept: npt.NDArray[np.bool_] | None = None,
    ) -> FloatArray:
        """Return paths (M + 1, S, P) from `starts` (S, P) over N steps; NaN from where one has no finite step.

        Args:
            starts: initial states.
            inputs: (U, N), held in each step.
            lengths: of the steps (N,).
            is_kept: after which steps (N,) states are returned; None: after each.
        """
        rows, states = [starts], starts
        for step, length in enumerate(lengths.tolist()):
            states = self._moved(states, inputs[:, step], length)
            if is_kept is None or is_kept[step]:
                rows.append(states)
        return np.array(rows)

    def _moved(self, states: FloatArray, inputs: FloatArray, length: float) -> FloatArray:
        count = states.shape[1]
        points = np.concatenate([states, np.repeat(inputs[:, None], count, axis=1)])
        moments = self.moments(points, np.full(count, length))
        normal = self.random.standard_normal(states.shape)
        factor = np.zeros_like(moments.covariance)
        moved = states + moments.mean
        with np.errstate(all="ignore"):
            for i in range(len(states)):
                for j in range(i + 1):
                    rest = moments.covariance[i, j] - (factor[i, :j] * factor[j, :j]).sum(axis=0)
                    factor[i, j] = np.sqrt(rest) if i == j else np.where(rest == 0.0, 0.0, rest / factor[j, j])
                moved[i] += (factor[i, : i + 1] * normal[: i + 1]).sum(axis=0)
        return np.where(np.isfinite(moved).all(axis=0), moved, np.nan)


@dataclass(frozen=True, eq=False)
class Ensemble:
    """Paths of a process from one initial state.

    `t` (N,) are the times, `x` (P, N, S) the `states` of each path, NaN from where a path has no finite step.
    """

    states: tuple[str, ...]
    t: FloatArray
    x: FloatArray
    time: str = "t"

    def __getitem__(self, state: str) -> FloatArray:
        """Return the values (P, N) of a state by name; raises KeyError."""
        if state not in self.states:
            raise KeyError(state)
        return np.asarray(self.x[:, :, self.states.index(state)])

    def __repr__(self) -> str:
        times = f"{len(self.t)} times from {self.t[0]:.6g} to {self.t[-1]:.6g}"
        return f"<Ensemble of {', '.join(self.states)}: {times}; {self.message}>"

    def band(self, state: str) -> tuple[FloatArray, FloatArray]:
        """Return the bounds (N,) that 5 % of the paths lie below and above, of a state by name; raises KeyError."""
        if state not in self.states:
            raise KeyError(state)
        place = self.states.index(state)
        return self.lower[:, place], self.upper[:, place]

    def to_frame(self, library: FrameLibrary = "polars") -> "polars.DataFrame | Any":
        """Return the `columns` as a frame of ``"polars"`` or ``"pandas"``; raises UsageError if it is missing."""
        return frame_of(self.columns(), library)

    @cached_property
    def finite(self) -> FloatArray:
        """The paths (K, N, S) that have finite states to the end: of these are the mean and the bounds."""
        return np.asarray(self.x[np.isfinite(self.x[:, -1]).all(axis=1)])

    @cached_property
    def mean(self) -> FloatArray:
        """The mean (N, S); NaN where no path is finite."""
        return self._over(lambda paths: np.mean(paths, axis=0))

    @property
    def lower(self) -> FloatArray:
        """The bound (N, S) that 5 % of the paths lie below."""
        return np.asarray(self._quantiles[0])

    @property
    def median(self) -> FloatArray:
        """The median (N, S)."""
        return np.asarray(self._quantiles[1])

    @property
    def upper(self) -> FloatArray:
        """The bound (N, S) that 5 % of the paths lie above."""
        return np.asarray(self._quantiles[2])

    @cached_property
    def _quantiles(self) -> FloatArray:
        return self._over(lambda paths: np.quantile(paths, SHARES, axis=0), len(SHARES))

    def _over(self, function: Callable[[FloatArray], FloatArray], *shape: int) -> FloatArray:
        values = function(self.finite) if len(self.finite) else np.full((*shape, *self.x.shape[1:]), np.nan)
        return np.asarray(values)

    @property
    def message(self) -> str:
        """How many paths there are, and how many of them end early, in a sentence."""
        lost = len(self.x) - len(self.finite)
        return f"{len(self.x)} paths" + (f", {lost} of which have no finite state to the end" if lost else "")

    def columns(self) -> dict[str, FloatArray]:
        """Return the time and, of each state, mean, median and bounds (N,), by column name."""
        columns = {self.time: self.t}
        for place, name in enumerate(self.states):
            for kind in ("mean", "lower", "median", "upper"):
                columns[f"{name}_{kind}"] = getattr(self, kind)[:, place]
        return columns

    def rows_of_paths(self) -> Iterator[list[str | int]]:
        """Yield the lines of a table of all paths, the header first, in the format that data are read in."""
        yield ["trajectory", self.time, *self.states]
        for number, path in enumerate(self.x, start=1):
            for at, states in zip(self.t.tolist(), path.tolist(), strict=True):
                yield [number, repr(at), *map(repr, states)]

    def to_csv(self, *, has_paths: bool = False) -> str:
        """Return the columns as CSV, numbers with all their digits; or the paths, as rows with a column trajectory."""
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        if has_paths:
            writer.writerows(self.rows_of_paths())
            return stream.getvalue()
        columns = self.columns()
        writer.writerow(columns)
        writer.writerows(zip(*(map(repr, values.tolist()) for values in columns.values()), strict=True))
        return stream.getvalue()

    def as_dict(self, *, has_paths: bool = False) -> dict[str, object]:
        """Return everything as plain lists and texts, for JSON; numbers that are not finite are None."""
        entries: dict[str, object] = {
            "paths": len(self.x),
            "finite_paths": len(self.finite),
            "columns": {name: _plain(values) for name, values in self.columns().items()},
        }
        if has_paths:
            entries["states"] = {name: [_plain(path) for path in self[name]] for name in self.states}
        return entries


def step_counts(times: FloatArray, longest: float) -> FloatArray:
    """Return into how many equal steps, no longer than `longest`, gaps between ascending times are divided."""
    return np.maximum(np.ceil(np.diff(times) / longest - _SLACK), 1.0)


def divided(times: FloatArray, longest: float) -> tuple[FloatArray, FloatArray, npt.NDArray[np.bool_]]:
    """Return where steps begin (N,), their lengths, and which of them end at one of the ascending `times`.

    Gaps between times are divided into equal steps that are no longer than `longest`.
    """
    begins, lengths, ends = [], [], []
    counts = step_counts(times, longest).astype(int).tolist()
    for begin, end, count in zip(times[:-1].tolist(), times[1:].tolist(), counts, strict=True):
        step = (end - begin) / count
        begins += [begin + k * step for k in range(count)]
        lengths += [step] * count
        ends += [False] * (count - 1) + [True]
    return np.array(begins), np.array(lengths), np.array(ends, dtype=np.bool_)


def _plain(values: FloatArray) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in values.tolist()]
