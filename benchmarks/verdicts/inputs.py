"""Laws with a measured input: smooth ones and held ones (constant between rows), sampled coarsely.

Variant ``hold`` says with ``--hold u`` that the input is held, where the command line has that option.
"""

import math
from typing import Final

import numpy as np

from atoll.client.job_options import OPTIONS
from atoll_core.data.dataset import FloatArray
from benchmarks.harness.solving import DivergedError
from benchmarks.verdicts.drawn import FRESH, Drawn, Measured, with_errors
from benchmarks.verdicts.simulation import Input, Run

LAWS: Final = {
    "first order": ({"x": "-k1*x + k2*u"}, {"k1": (0.3, 1.2), "k2": (0.5, 2.5)}),
    "spring": ({"x": "v", "v": "-k1*x - k2*v + k3*u"}, {"k1": (0.6, 2.0), "k2": (0.1, 0.6), "k3": (0.5, 2.0)}),
    "gain": ({"x": "-k1*x + k2*u*x + k3"}, {"k1": (0.6, 1.5), "k2": (0.1, 0.4), "k3": (0.5, 2.0)}),
    "drag": ({"x": "k1*u - k2*x**2"}, {"k1": (0.5, 2.0), "k2": (0.2, 1.0)}),
}
LEVELS: Final = (0.01, 0.0, 0.03)
A_PERIOD: Final = (5.0, 14.0)
"""Rows a period of the fastest wave of a smooth input, drawn."""


def has_hold() -> bool:
    """Tell whether ``coordinator run`` knows how inputs are held."""
    return "hold" in OPTIONS


def draw(seed: int, variant: str = "") -> Drawn:
    """Return the table of a seed: laws in turn, smooth and held in turn; `variant`: "", or "hold"."""
    name = [*LAWS][seed // 2 % len(LAWS)]
    rng = np.random.default_rng([seed, 104])
    while True:
        try:
            return _driven(name, bool(seed % 2), LEVELS[seed // 8 % len(LEVELS)], variant, rng)
        except DivergedError:
            continue


def _driven(name: str, is_held: bool, level: float, variant: str, rng: np.random.Generator) -> Drawn:
    texts, ranges = LAWS[name]
    constants = {key: float(f"{rng.uniform(*bounds):.2g}") for key, bounds in ranges.items()}
    rows = int(rng.integers(60, 140))
    period = float(rng.uniform(3.0, 8.0))
    step = float(f"{rng.uniform(0.1, 0.5) if is_held else period / rng.uniform(*A_PERIOD):.2g}")
    times = np.arange(rows, dtype=np.float64) * step

    def run() -> Run:
        start = tuple(float(f"{value:.3g}") for value in rng.uniform(0.2, 2.0, len(texts)))
        return Run(constants, start, times, {"u": _held(rng, times) if is_held else _smooth(rng, period)}, is_held)

    runs = [run()]
    measured = Measured(texts, runs, [run() for _ in range(FRESH)], tuple(texts))
    solutions = measured.solutions()
    clean = measured.clean(solutions)
    (noisy,), errors = with_errors(solutions, level, None if level else 6, rng)
    columns = {"t": times, **dict(zip(texts, noisy.T, strict=True)), "u": clean["u"]}
    words = ("--inputs", "u", *(("--hold", "u") if variant == "hold" else ()))
    how = "held" if is_held else "smooth"
    return Drawn(f"{how}: {name}, {level:.0%}", columns, words, measured.laws(), clean, lambda: measured.t(errors),
                 measured.predict)  # fmt: skip


def _smooth(rng: np.random.Generator, period: float) -> Input:
    """Return three waves about 1, the fastest of one period."""
    phases = rng.uniform(0.0, 2.0 * math.pi, 3).tolist()
    sizes = rng.uniform(0.2, 0.5, 3).tolist()
    rates = [2.0 * math.pi / (period * factor) for factor in (1.0, 1.7, 3.9)]
    return lambda time: (
        1.0 + sum(size * math.sin(rate * time + phase) for size, rate, phase in zip(sizes, rates, phases, strict=True))
    )


def _held(rng: np.random.Generator, times: FloatArray) -> Input:
    """Return levels between 0 and 2 that hold for one to eight rows; half of the inputs have two levels alone."""
    longest, is_switch = int(rng.integers(1, 9)), rng.random() < 0.5
    values: list[float] = []
    while len(values) < len(times):
        level = float(rng.integers(0, 2)) if is_switch else round(float(rng.uniform(0.0, 2.0)), 3)
        values += [level] * int(rng.integers(1, longest + 1))
    step = float(times[1] - times[0])
    return lambda time: values[min(int(time / step + 1e-6), len(times) - 1)]
