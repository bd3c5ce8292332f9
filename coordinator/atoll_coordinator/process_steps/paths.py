"""Random paths of a process, ensembles of paths, and the stationary density.

Steps are normal with the mean and the covariance of `moments`; fits of constants use the same moments. Letters: S
states, U inputs, N steps or times, P paths, B bins.
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

from atoll_coordinator.process_steps.moments import StepMoments, factors_of
from atoll_core.data.dataset import FloatArray
from atoll_core.data.frames import FrameLibrary, csv_of, frame_of

if TYPE_CHECKING:
    import polars

PATHS: Final = 256
"""Number of paths of an ensemble: the error of a mean is 1/16 of the standard deviation of the paths."""
SHARES: Final = (0.05, 0.5, 0.95)
"""Shares of the paths below `lower`, `median` and `upper`."""
_SLACK: Final = 1e-9
"""Tolerance for rounding errors: the gap between two times may be longer than the sum of its steps, by at most this
share of a step."""
STEPS: Final = 500
"""Paths are assumed to be stationary after this number of steps. The density is computed from the same number of
further steps. If a test shows that the paths are not stationary, the further steps are simulated once more."""
_LONGER: Final = 1
"""How often the further steps are repeated for paths that are not stationary yet."""
BINS: Final = 40
"""Number of bins of a displayed density."""
_LEVEL: Final = 0.01
"""Significance level of the test of stationarity: the largest probability that stationary paths are rejected."""


@dataclass(frozen=True, eq=False)
class Simulator:
    """Draws random paths; `moments` returns the moments of steps from points (S + U, P) with lengths (P,)."""

    moments: Callable[[FloatArray, FloatArray], StepMoments]
    random: np.random.Generator

    def paths(
        self,
        starts: FloatArray,
        inputs: FloatArray,
        lengths: FloatArray,
        is_kept: npt.NDArray[np.bool_] | None = None,
    ) -> FloatArray:
        """Return paths (M + 1, S, P) that begin at `starts` (S, P) and have N steps; M of the states after a step are
        returned. A path is NaN after a step that is not finite.

        Args:
            starts: initial states.
            inputs: (U, N), constant in each step.
            lengths: lengths of the steps (N,).
            is_kept: marks the steps (N,) after which states are returned; None: after each step.
        """
        rows, states = [starts], starts
        for step, length in enumerate(lengths.tolist()):
            states = self._take_step(states, inputs[:, step], length)
            if is_kept is None or is_kept[step]:
                rows.append(states)
        return np.array(rows)

    def _take_step(self, states: FloatArray, inputs: FloatArray, length: float) -> FloatArray:
        count = states.shape[1]
        points = np.concatenate([states, np.repeat(inputs[:, None], count, axis=1)])
        moments = self.moments(points, np.full(count, length))
        normal = self.random.standard_normal(states.shape)
        with np.errstate(all="ignore"):
            moved = states + moments.mean + np.einsum("ijp,jp->ip", factors_of(moments.covariance), normal)
        return np.where(np.isfinite(moved).all(axis=0), moved, np.nan)


@dataclass(frozen=True, eq=False)
class Ensemble:
    """Paths of a process from one initial state.

    `t` (N,) are the times, and `x` (P, N, S) are the values of the `states` along each path. A path is NaN after a step
    that is not finite.
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
        """Return the 5 % and the 95 % quantile (N,) of the paths of a state, by its name; raises KeyError."""
        if state not in self.states:
            raise KeyError(state)
        place = self.states.index(state)
        return self.lower[:, place], self.upper[:, place]

    def to_frame(self, library: FrameLibrary = "polars") -> "polars.DataFrame | Any":
        """Return the `columns` as a frame of ``"polars"`` or ``"pandas"``.

        Raises UsageError if the library is not installed.
        """
        return frame_of(self.columns(), library)

    @cached_property
    def finite(self) -> FloatArray:
        """The paths (K, N, S) that are finite to the end; the mean and the quantiles are computed from them."""
        return np.asarray(self.x[np.isfinite(self.x[:, -1]).all(axis=1)])

    @cached_property
    def mean(self) -> FloatArray:
        """The mean (N, S); NaN where no path is finite."""
        return self._statistics_of_paths(lambda paths: np.mean(paths, axis=0))

    @property
    def lower(self) -> FloatArray:
        """The 5 % quantile (N, S)."""
        return np.asarray(self._quantiles[0])

    @property
    def median(self) -> FloatArray:
        """The median (N, S)."""
        return np.asarray(self._quantiles[1])

    @property
    def upper(self) -> FloatArray:
        """The 95 % quantile (N, S)."""
        return np.asarray(self._quantiles[2])

    @cached_property
    def _quantiles(self) -> FloatArray:
        return self._statistics_of_paths(lambda paths: np.quantile(paths, SHARES, axis=0), len(SHARES))

    def _statistics_of_paths(self, function: Callable[[FloatArray], FloatArray], *shape: int) -> FloatArray:
        values = function(self.finite) if len(self.finite) else np.full((*shape, *self.x.shape[1:]), np.nan)
        return np.asarray(values)

    @property
    def message(self) -> str:
        """A sentence with the number of paths, and the number of paths that end early."""
        lost = len(self.x) - len(self.finite)
        return f"{len(self.x)} paths" + (f", {lost} not finite to the end" if lost else "")

    def columns(self) -> dict[str, FloatArray]:
        """Return the columns (N,) by name: the time, and the mean, median and quantiles of each state."""
        columns = {self.time: self.t}
        for place, name in enumerate(self.states):
            for kind in ("mean", "lower", "median", "upper"):
                columns[f"{name}_{kind}"] = getattr(self, kind)[:, place]
        return columns

    def rows_of_paths(self) -> Iterator[list[str | int]]:
        """Yield the lines of a table of all paths, the header first, in a format that Atoll reads."""
        yield ["trajectory", self.time, *self.states]
        for number, path in enumerate(self.x, start=1):
            for at, states in zip(self.t.tolist(), path.tolist(), strict=True):
                yield [number, repr(at), *map(repr, states)]

    def to_csv(self, *, has_paths: bool = False) -> str:
        """Return the columns as CSV with all digits. If `has_paths`, return the paths instead, as rows with a column
        ``trajectory``."""
        if not has_paths:
            return csv_of({name: values.tolist() for name, values in self.columns().items()})
        stream = io.StringIO()
        csv.writer(stream, lineterminator="\n").writerows(self.rows_of_paths())
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
    """Return the number of steps in each gap between ascending times. The steps in a gap are equal and not longer than
    `longest`."""
    return np.maximum(np.ceil(np.diff(times) / longest - _SLACK), 1.0)


def divided(times: FloatArray, longest: float) -> tuple[FloatArray, FloatArray, npt.NDArray[np.bool_]]:
    """Divide the gaps between ascending `times` into equal steps that are not longer than `longest`.

    Return, for each of the N steps, the time at which it begins, its length, and whether it ends at one of the `times`.
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


@dataclass(frozen=True, eq=False)
class StationaryDensity:
    """The stationary density of each of the `states` of a process.

    `edges` (S, B + 1) bound the bins of `density` (S, B); `mean` and `sd` (S,) are moments of the states.
    """

    states: tuple[str, ...]
    edges: FloatArray
    density: FloatArray
    mean: FloatArray
    sd: FloatArray

    def __repr__(self) -> str:
        each = zip(self.states, self.mean.tolist(), self.sd.tolist(), strict=True)
        moments = ", ".join(f"{name} {mean:.4g} (standard deviation {sd:.4g})" for name, mean, sd in each)
        return f"<StationaryDensity: mean of {moments}>"

    def __getitem__(self, state: str) -> tuple[FloatArray, FloatArray]:
        """Return the edges (B + 1,) and the density (B,) of a state by name; raises KeyError."""
        if state not in self.states:
            raise KeyError(state)
        place = self.states.index(state)
        return np.asarray(self.edges[place]), np.asarray(self.density[place])


def settled_paths(simulator: Simulator, starts: FloatArray, inputs: FloatArray, length: float) -> FloatArray | None:
    """Return settled (stationary) paths (N, S, P) that begin at `starts` (S, P) and have steps of one length. None if
    the paths do not settle.

    Paths are settled if two means do not differ significantly between both halves of the steps: the mean of each state
    and the mean of its square. The test needs at least two paths. `inputs` (U,) are constant.
    """
    lengths, held = np.full(STEPS, length), np.repeat(inputs[:, None], STEPS, axis=1)
    states = simulator.paths(starts, held, lengths)[-1]
    for _ in range(1 + _LONGER):
        paths = simulator.paths(states, held, lengths)[1:]
        kept = paths[:, :, np.isfinite(paths[-1]).all(axis=0)]
        if kept.shape[2] < max(starts.shape[1] // 2, 2):
            return None
        if _is_settled(kept):
            return kept
        states = paths[-1]
    return None


def density_of(states: tuple[str, ...], paths: FloatArray, within: FloatArray | None = None) -> StationaryDensity:
    """Return the density of settled paths (N, S, P). The bins cover the range of the paths and the range of `within`
    (S, R)."""
    samples = [np.concatenate([values.ravel(), [] if within is None else within[place]])
            for place, values in enumerate(paths.transpose(1, 0, 2))]  # fmt: skip
    edges = np.array([np.linspace(values.min(), values.max(), BINS + 1) for values in samples])
    density = histograms(paths.transpose(1, 0, 2).reshape(len(edges), -1), edges)
    return StationaryDensity(states, edges, density, paths.mean(axis=(0, 2)), paths.std(axis=(0, 2)))


def histograms(values: FloatArray, edges: FloatArray) -> FloatArray:
    """Return the densities (S, B) of `values` (S, R) in bins between `edges` (S, B + 1)."""
    return np.array(
        [np.histogram(sample, bounds, density=True)[0] for sample, bounds in zip(values, edges, strict=True)]
    )


def _is_settled(paths: FloatArray) -> bool:
    """Tell whether both halves of paths (N, S, P) agree in the means of states and of their squares.

    There are 2 S changes of means between the halves. Each change divided by its standard error has Student's t
    distribution; the standard error is estimated from the P paths. The significance level is divided by the number of
    changes (Bonferroni) and by 2 (two-sided test).
    """
    from scipy import special  # not needed by processes that only read results

    half = len(paths) // 2
    most = special.stdtrit(paths.shape[2] - 1, 1.0 - _LEVEL / (2 * 2 * paths.shape[1]))
    for power in (1, 2):
        moments = paths**power
        change = moments[half:].mean(axis=0) - moments[:half].mean(axis=0)
        error = change.std(axis=1, ddof=1) / np.sqrt(change.shape[1])
        if (np.abs(change.mean(axis=1)) > most * error).any():
            return False
    return True
