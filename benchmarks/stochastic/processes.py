"""Processes dx = f dt + g dW as text, and paths of them: 10,000 steps, in small steps of Euler and Maruyama."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.text.parsing import from_infix
from benchmarks.harness.systems import Sampled

SUBSTEPS: Final = 50
STEPS: Final = 10_000
SETTLING: Final = 100
"""Rows that are left out before the first one."""


@dataclass(frozen=True)
class Process:
    """A process: by state its `drift` and the square of its own noise, `diffusion`.

    `starts` of the states, one path for each `paths`, sampled at every `step`; `noise` is the standard deviation of
    errors of measurement. A process that does not settle begins at `starts`. Where a state has no noise of its own, the
    error of Euler's rule would be larger than what the state is uncertain by, so that the drift is that of Heun's then.
    """

    drift: Mapping[str, str]
    diffusion: Mapping[str, str]
    starts: Sequence[float]
    step: float = 0.05
    paths: int = 1
    noise: float = 0.0
    settles: bool = True

    @property
    def names(self) -> tuple[str, ...]:
        """The states."""
        return tuple(self.drift)

    @cached_property
    def truth(self) -> dict[str, str]:
        """The equations by the names that a result gives them."""
        return {**self.drift, **{f"[{name}]": text for name, text in self.diffusion.items()}}

    def function(self, texts: Iterable[str]) -> Callable[..., Sequence[Any]]:
        """Return expressions as a function of the states, in plain Python: of numbers, or of many paths at once."""
        made: Callable[..., Sequence[Any]] = eval(f"lambda {', '.join(self.names)}: ({', '.join(texts)},)")
        return made

    def values(self, text: str, states: FloatArray) -> FloatArray:
        """Return an expression at states (S, R)."""
        return values_of(from_infix(text, self.names), states).copy()


_WELL: Final = {"x": "x-x**3"}
PROCESSES: Final = {
    "Ornstein-Uhlenbeck": Process({"x": "-x"}, {"x": "0.25"}, [0.0]),
    "double well": Process(_WELL, {"x": "0.25"}, [1.0]),
    "double well, multiplicative": Process(_WELL, {"x": "0.25+0.25*x**2"}, [1.0]),
    "van der Pol": Process({"x": "y", "y": "(1-x**2)*y-x"}, {"x": "0.09", "y": "0.09"}, [1.0, 0.0]),
    "geometric Brownian motion": Process({"x": "0.15*x"}, {"x": "0.09*x**2"}, [1.0], paths=20, settles=False),
    "Lotka-Volterra": Process(
        {"x": "x-0.5*x*y", "y": "0.5*x*y-y"},
        {"x": "0.01*x**2", "y": "0.01*y**2"},
        [1.0, 2.0],
        step=0.02,
        paths=20,
        settles=False,
    ),
    "Ornstein-Uhlenbeck, errors of 0.1": Process({"x": "-x"}, {"x": "0.25"}, [0.0], noise=0.1),
    "Duffing": Process({"x": "v", "v": "x-x**3-0.5*v"}, {"x": "0", "v": "0.25"}, [1.0, 0.0]),
    "FitzHugh-Nagumo": Process(
        {"x": "5*(x-x**3-y)", "y": "1.5*x-y+0.3"}, {"x": "0", "y": "0.09"}, [1.0, 0.0], step=0.02
    ),
    "Lorenz": Process(
        {"x": "10*(y-x)", "y": "x*(28-z)-y", "z": "x*y-8*z/3"},
        {"x": "4", "y": "4", "z": "4"},
        [1.0, 2.0, 20.0],
        step=0.01,
    ),
}


def simulate(process: Process, seed: int, steps: int = STEPS, substeps: int = SUBSTEPS) -> list[FloatArray]:
    """Return the paths (S, R) of one seed, as they are measured: so many steps in all.

    With one substep they are what the method of Euler and Maruyama makes, a row for each of its steps.
    """
    random = np.random.default_rng(seed)
    count = steps // process.paths
    settling = SETTLING if process.settles else 0
    paths = [_path(process, settling + count + 1, random, substeps)[:, settling:] for _ in range(process.paths)]
    return [path + process.noise * random.standard_normal(path.shape) for path in paths]


def _path(process: Process, rows: int, random: np.random.Generator, substeps: int) -> FloatArray:
    """Return one path (S, R), in plain numbers: there are half a million small steps."""
    rates = process.function([*process.drift.values(), *process.diffusion.values()])
    small, size = process.step / substeps, len(process.names)
    is_corrected = "0" in process.diffusion.values() and substeps > 1
    states, path = [*process.starts], [[*process.starts]]
    for _ in range(rows - 1):
        normal = (random.standard_normal((substeps, size)) * np.sqrt(small)).tolist()
        for draws in normal:
            before = rates(*states)
            moved = [
                state + small * rate + math.sqrt(square) * draw
                for state, rate, square, draw in zip(states, before, before[size:], draws, strict=False)
            ]
            if is_corrected:
                after = rates(*moved)
                moved = [
                    state + 0.5 * small * (end - begin)
                    for state, begin, end in zip(moved, before, after[:size], strict=False)
                ]
            states = moved
        path.append(states)
    return np.ascontiguousarray(np.array(path).T)


def sampled(process: Process, paths: Sequence[FloatArray]) -> Sampled:
    """Return paths (S, R) with their times."""
    times = tuple(process.step * np.arange(path.shape[1], dtype=np.float64) for path in paths)
    return Sampled(process.names, times, tuple(path.T for path in paths))
