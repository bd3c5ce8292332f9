"""What becomes of exact solutions when they are simulated or measured: one name for each kind and size of error.

``exact``; ``rk45-1e-3`` (the tolerances of `solve_ivp` when none are given), ``rk45-R``, ``lsoda-R`` with relative
tolerance R; ``euler-N`` with N steps between two rows; ``digits-N``, ``float32``; and, with a share S of each state's
deviation, ``noise-S`` (Gaussian), ``proportional-S`` (of the value), ``ar1-S`` (correlated 0.9 from row to row; R times
with ``arR-S``, such as ar0.5-0.01),
``drift-S`` (noise and a slow drift of the same size), ``outliers-S`` (one row in fifty ten times as far),
``quantised-S`` (steps), ``filtered-S`` (noise and signal behind a low-pass filter of one row's time constant).
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from benchmarks.corpus.systems import CorpusSystem, solution

NEIGHBOURS: Final = 0.9
"""Correlation of neighbouring rows of ``ar1``; of ``ar0.5`` it is 0.5."""

OUTLIERS: Final = 0.02
FAR: Final = 10.0
DEFAULT_ATOL: Final = 1e-6
"""Of `solve_ivp`."""

QUALITIES: Final = (
    "exact", "rk45-1e-3", "rk45-1e-6", "rk45-1e-9", "lsoda-1e-3", "lsoda-1e-7", "euler-20", "digits-4", "digits-6",
    "float32", "noise-1e-5", "noise-1e-4", "noise-0.001", "noise-0.01", "noise-0.05", "noise-0.1", "noise-0.2",
    "proportional-0.01", "ar1-0.001", "ar1-0.01", "drift-0.01", "outliers-0.01", "quantised-0.01", "filtered-0.01",
)  # fmt: skip
"""Those that a campaign over everything has."""

NAMED_QUALITIES: Final = ("rk45-1e-3", "rk45-1e-6", "lsoda-1e-7", "digits-4", "noise-0.001", "noise-0.01")

_NAMED_CORRELATION: Final = re.compile(r"ar(0\.\d+)")

_Disturb = Callable[[list[FloatArray], float, np.random.Generator], list[FloatArray]]


@dataclass(frozen=True)
class Quality:
    """One kind of error and its size."""

    kind: str
    size: float

    @property
    def is_solved(self) -> bool:
        """Whether the errors are those of a solver."""
        return self.kind in ("rk45", "lsoda", "euler")

    @property
    def neighbours(self) -> float | None:
        """The correlation of neighbouring rows that the kind names; None where it names none."""
        named = _NAMED_CORRELATION.fullmatch(self.kind)
        return None if named is None else float(named[1])


def quality(name: str) -> Quality:
    """Return the quality of a name; raises UsageError where there is none."""
    kind, _, size = name.partition("-")
    try:
        parsed = Quality(kind, float(size) if size else 0.0)
    except ValueError:
        parsed = Quality("", 0.0)
    is_measured = parsed.kind in _MEASURED or parsed.neighbours is not None
    known = is_measured or parsed.is_solved or parsed.kind in ("exact", "float32", "digits")
    if not known or (kind in ("exact", "float32")) == bool(size):
        raise UsageError(f"{name!r} is no quality of the corpus; name one such as {', '.join(QUALITIES[:6])}")
    return parsed


def measure(
    quality: Quality, system: CorpusSystem, starts: Sequence[Sequence[float]], times: Sequence[FloatArray],
    clean: Sequence[FloatArray], rng: np.random.Generator,
) -> list[FloatArray]:  # fmt: skip
    """Return what is measured of the solutions `clean`, an array (n, S) for each of `starts` at `times` (n,)."""
    if quality.is_solved:
        return [_solve(quality, system, start, when) for start, when in zip(starts, times, strict=True)]
    if quality.kind == "exact":
        return [states.copy() for states in clean]
    if quality.kind == "float32":
        return [states.astype(np.float32).astype(np.float64) for states in clean]
    if quality.kind == "digits":
        return [_in_digits(states, round(quality.size)) for states in clean]
    if quality.neighbours is not None:
        return _correlated(list(clean), quality.size, rng, quality.neighbours)
    return _MEASURED[quality.kind](list(clean), quality.size, rng)


def _solve(quality: Quality, system: CorpusSystem, start: Sequence[float], times: FloatArray) -> FloatArray:
    field = system.field()
    if quality.kind == "euler":
        return _by_euler(field, start, times, round(quality.size))
    atol = DEFAULT_ATOL if quality.size >= DEFAULT_ATOL else quality.size
    return solution(field, start, times, quality.kind.upper(), quality.size, atol)


def _by_euler(field: Callable[[Sequence[float]], list[float]], start: Sequence[float], times: FloatArray,
              steps: int) -> FloatArray:  # fmt: skip
    state = np.array(start, dtype=np.float64)
    rows = [state]
    for step in np.diff(times).tolist():
        for _ in range(steps):
            state = state + step / steps * np.array(field(state.tolist()))
        rows.append(state)
    return np.array(rows)


def _in_digits(values: FloatArray, digits: int) -> FloatArray:
    return np.array([[float(f"{value:.{digits}g}") for value in row] for row in values.tolist()])


def _deviations(clean: Sequence[FloatArray]) -> FloatArray:
    return np.asarray(np.concatenate(clean).std(axis=0))


def _noise(clean: list[FloatArray], size: float, rng: np.random.Generator) -> list[FloatArray]:
    spread = size * _deviations(clean)
    return [states + spread * rng.standard_normal(states.shape) for states in clean]


def _proportional(clean: list[FloatArray], size: float, rng: np.random.Generator) -> list[FloatArray]:
    return [states * (1.0 + size * rng.standard_normal(states.shape)) for states in clean]


def _correlated(
    clean: list[FloatArray], size: float, rng: np.random.Generator, neighbours: float = NEIGHBOURS
) -> list[FloatArray]:
    spread = size * _deviations(clean)
    return [states + spread * _autoregressive(rng.standard_normal(states.shape), neighbours) for states in clean]


def _autoregressive(shocks: FloatArray, neighbours: float) -> FloatArray:
    errors = shocks.copy()
    scale = np.sqrt(1.0 - neighbours**2)
    for row in range(1, len(errors)):
        errors[row] = neighbours * errors[row - 1] + scale * shocks[row]
    return errors


def _drifting(clean: list[FloatArray], size: float, rng: np.random.Generator) -> list[FloatArray]:
    spread = size * _deviations(clean)
    drifted = []
    for states in _noise(clean, size, rng):
        along = np.linspace(-1.0, 1.0, len(states))[:, None]
        slope, bend = rng.standard_normal((2, 1, states.shape[1]))
        drifted.append(states + spread * (slope * along + bend * (along**2 - 1.0 / 3.0)))
    return drifted


def _with_outliers(clean: list[FloatArray], size: float, rng: np.random.Generator) -> list[FloatArray]:
    spread = size * _deviations(clean)
    disturbed = []
    for states in _noise(clean, size, rng):
        is_out = rng.random(states.shape) < OUTLIERS
        disturbed.append(states + is_out * FAR * spread * rng.choice((-1.0, 1.0), states.shape))
    return disturbed


def _quantised(clean: list[FloatArray], size: float, _rng: np.random.Generator) -> list[FloatArray]:
    step = size * _deviations(clean)
    return [np.round(states / step) * step for states in clean]


def _filtered(clean: list[FloatArray], size: float, rng: np.random.Generator) -> list[FloatArray]:
    share = 1.0 - np.exp(-1.0)
    filtered = []
    for states in _noise(clean, size, rng):
        rows = states.copy()
        for row in range(1, len(rows)):
            rows[row] = rows[row - 1] + share * (states[row] - rows[row - 1])
        filtered.append(rows)
    return filtered


_MEASURED: Final[dict[str, _Disturb]] = {
    "noise": _noise,
    "proportional": _proportional,
    "ar1": _correlated,
    "drift": _drifting,
    "outliers": _with_outliers,
    "quantised": _quantised,
    "filtered": _filtered,
}
