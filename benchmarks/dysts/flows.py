"""The flows that `making` wrote: trajectories, true equations, noise, and the table that a search is given."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from atoll_core.errors import DataError
from benchmarks.harness.jobs import table_of_columns

NEVER_POLYNOMIAL: Final = ("+", "-", "*", "/", "sin", "cos", "exp", "abs", "tanh")
"""Operators of flows that are not polynomial: one list for all of them."""


@dataclass(frozen=True, eq=False)
class Flow:
    """One flow: `times` (R,), `train` and `test` (K, R, D) without noise, `test_rates` (K, R, D), its true `equations`.

    Equations are infix text over `states`, empty where there is none. `lyapunov` is the published largest exponent,
    NaN where there is none.
    """

    name: str
    states: tuple[str, ...]
    equations: tuple[str, ...]
    times: FloatArray
    train: FloatArray
    test: FloatArray
    test_rates: FloatArray
    lyapunov: float

    def table(self, percent: float, seed: int) -> Table:
        """Return the training trajectories with Gaussian noise of so many percent of the root mean square.

        One standard deviation for all states: that share of the mean over the states of their root mean squares.
        """
        generator = np.random.default_rng(np.random.SeedSequence([seed, *self.name.encode(), round(1e4 * percent)]))
        size = float(np.sqrt((self.train**2).mean(axis=(0, 1))).mean())
        values = self.train + 0.01 * percent * size * generator.standard_normal(self.train.shape)
        count, rows, states = values.shape
        measured = dict(zip(self.states, values.reshape(count * rows, states).T, strict=True))
        return table_of_columns({"t": np.tile(self.times, count), **measured}, self.name, range(0, count * rows, rows))


def available(folder: Path) -> tuple[str, ...]:
    """Return the names of the flows in `folder`."""
    return tuple(sorted(path.stem for path in folder.glob("*.npz")))


def load(folder: Path, name: str) -> Flow:
    """Return the flow that was written as ``NAME.npz``; raises DataError."""
    try:
        with np.load(folder / f"{name}.npz") as file:
            states, equations = (tuple(map(str, file[key])) for key in ("states", "equations"))
            times, *values = (np.ascontiguousarray(file[key]) for key in ("times", "train", "test", "test_rates"))
            train, test, rates = values
            return Flow(name, states, equations, times, train, test, rates, float(file["lyapunov"]))
    except (OSError, KeyError, ValueError) as error:
        raise DataError(f"{folder / name}.npz is no flow; write it with python -m benchmarks.dysts make") from error
