"""The density that paths of a process settle into. Letters: S states, N times, P paths, B bins."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll_coordinator.stochastic.paths import Simulator
from atoll_core.data.dataset import FloatArray

STEPS: Final = 500
"""In which a density settles, and over as many it is taken; it may take as long again."""
_LONGER: Final = 1
BINS: Final = 40
"""Of a density that is shown."""
_LEVEL: Final = 0.01
"""With which probability at most the test says of settled paths that they still change; they are tested once more."""


@dataclass(frozen=True, eq=False)
class StationaryDensity:
    """The density of each of the `states` that a process settles into.

    `edges` (S, B + 1) bound the bins of `density` (S, B); `mean` and `sd` (S,) are those of the process.
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
    """Return paths (N, S, P) after they have settled, from `starts` (S, P) in steps of one length; None: they do not.

    They have settled when the means of states and of their squares no longer change from one half to the other by more
    than chance does; two paths at least tell that. `inputs` (U,) are held.
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
    """Return the density of settled paths (N, S, P); bins are over their range, and that of `within` (S, R)."""
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
    """Tell whether two halves of paths (N, S, P) agree in the means of states and of their squares.

    Each of the 2 S changes has Student's distribution over its error from P paths, one by one; the level is divided
    among them (Bonferroni), and among both signs.
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
