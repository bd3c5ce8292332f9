"""The measured trajectories laid out for fits: all rows one after another, and what is simulated of them.

Letters: N rows of all trajectories, S states, D of them with an equation here, O measured ones, U inputs.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from common.dataset import FloatArray
from common.expression.kernels import Ints
from coordinator.data.recording import Recording, Trajectory

ROOM: Final = 3.0
"""A simulated state may leave the measured range by so many times its width before it counts as blown up."""


@dataclass(frozen=True, eq=False)
class Measurements:
    """Rows of trajectories for a system of D equations.

    `bounds` (T, 2) are the half-open row ranges of the trajectories; `measured` and `smoothed` are (O, N) and (D, N);
    `observed` (O,) tells which of the D states are measured; `scales` (D,) are their standard deviations, `noise` (O,)
    the smoother's estimate of the measurement errors' standard deviation. `input_slopes` belong to `inputs` (U, N).
    """

    bounds: Ints
    times: FloatArray
    measured: FloatArray
    smoothed: FloatArray
    observed: Ints
    inputs: FloatArray
    input_slopes: FloatArray
    scales: FloatArray
    noise: FloatArray
    names: tuple[str, ...]

    @property
    def rows(self) -> int:
        """Number of rows of all trajectories."""
        return len(self.times)

    @cached_property
    def limits(self) -> FloatArray:
        """Range (D, 2) outside of which a simulated state has blown up."""
        low, high = self.smoothed.min(axis=1), self.smoothed.max(axis=1)
        width = np.maximum(high - low, 1e-12 * np.maximum(np.abs(high), np.abs(low)))
        return np.ascontiguousarray(np.stack([low - ROOM * width, high + ROOM * width], axis=1))

    def segments(self, length: int | None) -> Ints:
        """Return row ranges (G, 2) of about `length` rows each that cover all trajectories; whole ones for None."""
        ranges: list[tuple[int, int]] = []
        for first, end in self.bounds.tolist():
            count = 1 if length is None else max(1, round((end - first) / length))
            cuts = [first + (end - first) * k // count for k in range(count + 1)]
            ranges += zip(cuts[:-1], cuts[1:], strict=True)
        return np.array(ranges, dtype=np.int64)

    def only(self, keep: Sequence[int]) -> "Measurements":
        """Return the measurements of some trajectories, by index."""
        rows = np.concatenate([np.arange(*self.bounds[index]) for index in keep])
        lengths = [int(self.bounds[index, 1] - self.bounds[index, 0]) for index in keep]
        ends = np.cumsum(lengths)
        bounds = np.stack([ends - lengths, ends], axis=1).astype(np.int64)

        def of(values: FloatArray) -> FloatArray:
            return np.ascontiguousarray(values[:, rows])

        return replace(
            self,
            bounds=bounds,
            times=np.ascontiguousarray(self.times[rows]),
            measured=of(self.measured),
            smoothed=of(self.smoothed),
            inputs=of(self.inputs),
            input_slopes=of(self.input_slopes),
        )


def measurements_of(recording: Recording, modelled: Sequence[int], held_out: bool = False) -> Measurements:
    """Return the measurements for a system whose equations are those of the `modelled` states (indices).

    The other states, as smoothed, are inputs behind the recording's own. With order 2 the velocities of the modelled
    states are states, too, behind the positions, and not measured.
    """
    parts = [each for each in recording.trajectories if each.held_out == held_out]
    return _laid_out(recording, parts, list(modelled))


def _laid_out(recording: Recording, parts: list[Trajectory], modelled: list[int]) -> Measurements:
    others = [index for index in range(len(recording.states)) if index not in modelled]
    lengths = [len(part.times) for part in parts]
    ends = np.cumsum(lengths)

    def stacked(arrays: list[FloatArray]) -> FloatArray:
        return np.ascontiguousarray(np.concatenate(arrays, axis=1))

    measured = stacked([part.measured[modelled] for part in parts])
    positions = stacked([part.smoothed[modelled] for part in parts])
    smoothed = positions
    inputs = [stacked([part.inputs for part in parts]), stacked([part.smoothed[others] for part in parts])]
    slopes = [stacked([part.input_slopes for part in parts]), stacked([part.slopes[others] for part in parts])]
    names = [*(recording.state_symbols[index] for index in modelled)]
    if recording.order == 2:
        smoothed = np.concatenate([positions, stacked([part.slopes[modelled] for part in parts])])
        names += [recording.velocity_symbols[index] for index in modelled]
    names += [*recording.input_symbols, *(recording.state_symbols[index] for index in others)]
    if recording.order == 2 and others:
        inputs.append(stacked([part.slopes[others] for part in parts]))
        slopes.append(np.concatenate([_gradients(part, others) for part in parts], axis=1))
        names += [recording.velocity_symbols[index] for index in others]
    return Measurements(
        bounds=np.stack([ends - lengths, ends], axis=1).astype(np.int64),
        times=np.concatenate([part.times for part in parts]),
        measured=measured,
        smoothed=np.ascontiguousarray(smoothed),
        observed=np.arange(len(modelled), dtype=np.int64),
        inputs=np.ascontiguousarray(np.concatenate(inputs)),
        input_slopes=np.ascontiguousarray(np.concatenate(slopes)),
        scales=np.maximum(smoothed.std(axis=1), 1e-300),
        noise=np.array([recording.smoothing[index].noise for index in modelled]),
        names=tuple(names),
    )


def _gradients(part: Trajectory, states: list[int]) -> FloatArray:
    return np.gradient(part.slopes[states], part.times, axis=1)
