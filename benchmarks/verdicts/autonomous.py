"""Tables of systems of the corpus, for limits of time, sampling rates and strong noise."""

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from benchmarks.corpus.cases import fresh_paths, smallest_t
from benchmarks.corpus.families import FAMILIES
from benchmarks.corpus.systems import CorpusSystem, draw_family, draw_system, named_system, solution
from benchmarks.harness.solving import DivergedError
from benchmarks.judging.generalisation import foretold
from benchmarks.noise.data import Path
from benchmarks.verdicts import groups, targets
from benchmarks.verdicts.drawn import FRESH, Drawn, Predictions, with_errors

FULL: Final = "without"
LIMITED: Final = "limited"
"""Variants of a table: without a limit of time, and with one."""

FACTORS: Final = ("1", "3", "10", "30")
"""Variants of a trajectory: how many times as fast it is sampled."""

SLOWEST_ROWS: Final = 60
SLOWEST_HZ: Final = 20.0
SAMPLED: Final = ("van_der_pol", "lotka_volterra", "pendulum", "linear", "logistic", "motor")
RATE_LEVELS: Final = (0.01, 0.0, 0.03)

NOISY: Final = ("van_der_pol", "lorenz", "lotka_volterra", "pendulum", "linear", "duffing", "roessler", "logistic",
                "brusselator", "fitzhugh")  # fmt: skip
STRONG: Final = (0.2, 0.3, 0.4)
NOISY_ROWS: Final = 400

LIMIT_LEVELS: Final = (0.01, 0.05, 0.1)


def draw_limited(seed: int, _variant: str = "") -> Drawn:
    """Return a table whose job takes a while: a system of the corpus, one with a near copy of a column, a target."""
    rng = np.random.default_rng([seed, 105])
    level = LIMIT_LEVELS[seed // 3 % len(LIMIT_LEVELS)]
    if seed % 3 == 2:
        return targets.draw(seed)
    if seed % 3 == 1:
        return _with_copy(level, rng)
    system = draw_system(seed, 1 + seed // 3 % 2)
    return _noisy(system, f"{system.name}, {level:.0%}", int(rng.integers(60, 200)), level, None, rng)


def draw_at_rate(seed: int, variant: str = "1") -> Drawn:
    """Return the trajectory of a seed, with `variant` times as many rows in the same time."""
    rng = np.random.default_rng([seed, 106])
    name = SAMPLED[seed % len(SAMPLED)]
    if name == "motor":
        return groups.motor(SLOWEST_HZ * float(variant), rng)
    level = RATE_LEVELS[seed // len(SAMPLED) % len(RATE_LEVELS)]
    rows = (SLOWEST_ROWS - 1) * int(variant) + 1
    return _noisy(draw_family(name, seed), f"{name}, {level:.0%}", rows, level, None if level else 6, rng)


def draw_noisy(seed: int, _variant: str = "") -> Drawn:
    """Return a table of 400 rows with errors of 20 to 40 % of the deviation."""
    name, level = NOISY[seed % len(NOISY)], STRONG[seed // len(NOISY) % len(STRONG)]
    system = named_system(name) if name == "lorenz" else draw_family(name, seed)
    rng = np.random.default_rng([seed, 107])
    return _noisy(system, f"{name}, {level:.0%}", NOISY_ROWS, level, None, rng)


def _noisy(
    system: CorpusSystem, kind: str, rows: int, level: float, digits: int | None, rng: np.random.Generator
) -> Drawn:  # fmt: skip
    """Return the table of one trajectory with normal errors; fresh ones begin anywhere in the measured box."""
    times = np.linspace(0.0, system.duration, rows)
    start, clean = _trajectory(system, times, rng)
    columns = dict(zip(system.states, clean.T, strict=True))
    paths = fresh_paths(system, columns, times, rng)
    (measured,), _ = with_errors([clean], level, digits, rng)
    return Drawn(
        kind, {"t": times, **dict(zip(system.states, measured.T, strict=True))}, (), {"": dict(system.truths)}, columns,
        lambda: smallest_t(system, [start], [times], [clean], [measured]), PathPredictions(system.states, paths),
    )  # fmt: skip


def _trajectory(
    system: CorpusSystem, times: FloatArray, rng: np.random.Generator
) -> tuple[tuple[float, ...], FloatArray]:  # fmt: skip
    while True:
        start = system.starts[0] if system.starts else system.draw_start(rng)
        try:
            return start, solution(system.field(), start, times)
        except DivergedError:
            if system.starts:
                raise


class PathPredictions:
    """R² by state of a model along fresh trajectories; a copy of a state begins where that does."""

    def __init__(self, states: Sequence[str], paths: Sequence[Path]) -> None:
        """Judge by `paths`, whose states are `states`."""
        self._states, self._paths = tuple(states), tuple(paths)

    def __call__(self, models: Mapping[str, Mapping[str, str | None]]) -> Predictions:
        """Return R² of the model of the only group, nan where there is nothing to judge by."""
        texts = {state: models[""].get(state) for state in self._states}
        r2 = foretold(texts, self._paths) if self._paths else dict.fromkeys(texts, math.nan)
        return {state: (value, math.nan) for state, value in r2.items()}


def _with_copy(level: float, rng: np.random.Generator) -> Drawn:
    """Return predators and prey, and the prey counted once more."""
    rows = int(rng.integers(120, 240))
    family, constants = FAMILIES["lotka_volterra"], {"k1": 2.0, "k2": 1.0, "k3": 1.0, "k4": 1.5}
    changed = {name: float(f"{value * rng.uniform(0.7, 1.4):.2g}") for name, value in constants.items()}
    both = CorpusSystem("prey and a copy", family.equations, changed, ((0.5, 3.0), (0.5, 3.0)), 0.1 * rows)
    times = np.arange(rows, dtype=np.float64) * 0.1
    start, clean = _trajectory(both, times, rng)
    columns = dict(zip(both.states, clean.T, strict=True))
    paths = [
        Path(path.times, np.column_stack([path.states, path.states[:, 0]]))
        for path in fresh_paths(both, columns, times, rng)[:FRESH]
    ]
    share = 0.01 * level / LIMIT_LEVELS[0]
    (measured,), _ = with_errors([np.column_stack([clean, clean[:, 0]])], share, None, rng)
    names = (*both.states, "z")
    return Drawn(
        f"copy, {share:.0%}", {"t": times, **dict(zip(names, measured.T, strict=True))}, (), {"": dict(both.truths)},
        {**columns, "z": clean[:, 0]}, lambda: smallest_t(both, [start], [times], [clean], [measured[:, :2]]),
        PathPredictions(names, paths),
    )  # fmt: skip
