"""Several runs of one law: constants that differ between groups or runs, that are shared, or differ unsaid.

``group``: ``--trajectory run --group strain``, one constant a group; ``own``: ``--per-trajectory``; ``shared``: several
runs of the same constants; ``unsaid``: runs with constants of their own, although none of this is said; no single law
describes them then. ``motor``: a driven pendulum of two masses, by angles sampled slowly or fast.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from benchmarks.harness.solving import DivergedError
from benchmarks.verdicts.drawn import Drawn, Laws, Measured, nice_step, with_errors
from benchmarks.verdicts.few_rows import fresh
from benchmarks.verdicts.laws import COOLING, DECAY, ENZYME, LOGISTIC, OSCILLATOR, PREY, Law
from benchmarks.verdicts.simulation import CONSTANT, Input, Run

KINDS: Final = ("group", "own", "shared", "unsaid", "group", "motor")
FROM: Final = {"decay": DECAY, "cooling": COOLING, "logistic": LOGISTIC, "oscillator": OSCILLATOR, "enzyme": ENZYME,
               "prey": PREY}  # fmt: skip
LEVELS: Final = (0.01, 0.03, 0.0)
ROWS: Final = (12, 40)
RATES: Final = (20.0, 100.0, 1000.0)
"""Rows a second of the driven pendulum, which turns in about a second."""

_APART: Final = (0.6, 0.8, 1.25, 1.6)
"""Factors between the constants of groups."""


def draw(seed: int, _variant: str = "") -> Drawn:
    """Return the table of a seed, kinds and laws in turn."""
    kind = KINDS[seed % len(KINDS)]
    rng = np.random.default_rng([seed, 103])
    if kind == "motor":
        return motor(RATES[seed // len(KINDS) % len(RATES)], rng)
    name = [*FROM][(seed + seed // len(KINDS)) % len(FROM)]
    while True:
        try:
            return _runs(kind, name, FROM[name], float(rng.choice(LEVELS)), rng)
        except DivergedError:
            continue


def _runs(kind: str, name: str, law: Law, level: float, rng: np.random.Generator) -> Drawn:
    constants = law.draw_constants(rng)
    rows, number = int(rng.integers(ROWS[0], ROWS[1] + 1)), int(rng.integers(2, 5))
    times = np.arange(rows, dtype=np.float64) * nice_step(law.draw_duration(constants, rng) / (rows - 1))
    own = () if kind == "shared" else (str(rng.choice([*constants])),)
    factors = rng.permutation(_APART)[:number]
    runs: list[Run] = []
    strains: list[str] = []
    for group in range(number):
        changed = {
            key: float(f"{value * factors[group]:.3g}") if key in own else value for key, value in constants.items()
        }
        for _ in range(int(rng.integers(1, 3)) if kind == "group" else 1):
            strains.append(f"s{group}")
            title = {"group": strains[-1], "own": f"{len(runs) + 1}", "unsaid": f"{len(runs) + 1}"}.get(kind, "")
            runs.append(Run(changed, law.draw_start(changed, rng), times, group=title))
    measured = Measured(law.equations, runs, [], law.measured, own)
    solutions = measured.solutions()
    others = [one for run, states in zip(runs, solutions, strict=True) for one in fresh(run, states, rng)[:2]]
    whole = Measured(law.equations, runs, others, law.measured, own)
    noisy, errors = with_errors(solutions, level, 4, rng)
    columns = {
        "t": np.concatenate([times] * len(runs)),
        **dict(zip(law.measured, np.concatenate(noisy).T, strict=True)),
    }
    labels = {"run": [f"{number + 1}" for number in range(len(runs)) for _ in range(rows)]}
    words = ["--trajectory", "run"]
    if kind == "group":
        labels["strain"] = [strain for strain in strains for _ in range(rows)]
        words += ["--group", "strain"]
    words += ["--per-trajectory"] if kind == "own" else []
    laws = whole.laws()
    if kind == "unsaid":
        laws = {group: _without_own(law.equations, own, texts) for group, texts in laws.items()}
    return Drawn(
        f"{kind}: {name}, {level:.0%}", columns, tuple(words), laws, whole.clean(solutions), lambda: whole.t(errors),
        whole.predict, labels,
    )  # fmt: skip


def _without_own(equations: Mapping[str, str], own: Sequence[str], laws: Laws) -> Laws:
    """Return laws of which those are None that no constants make right for all runs."""
    return {name: None if set(own) & set(CONSTANT.findall(equations[name])) else law for name, law in laws.items()}


MOTOR: Final = {"th": "th_dot", "th_dot": "-k1*sin(th) - k2*th_dot + k3*u"}
"""A pendulum that a motor drives: angle, voltage."""


def motor(rate: float, rng: np.random.Generator) -> Drawn:
    """Return four runs of two masses, by their angles with 0.004 rad of noise."""
    times = np.arange(int(5.0 * rate), dtype=np.float64) / rate
    masses = {"light": 0.10, "heavy": 0.30}
    runs = []
    for number, (group, mass) in enumerate([*masses.items()] * 2):
        inertia = 0.004 + mass * 0.09
        constants = {"k1": mass * 9.81 * 0.3 / inertia, "k2": 0.012 / inertia, "k3": 0.05 / inertia}
        runs.append(Run(constants, (0.4 * (number - 1.5), 0.0), times, {"u": _voltage(rng)}, group=group))
    others = [Run(run.constants, (float(rng.uniform(-0.5, 0.5)), 0.0), times, {"u": _voltage(rng)}, group=run.group)
              for run in runs]  # fmt: skip
    measured = Measured(MOTOR, runs, others, ("th",), ("k1", "k2", "k3"), 2)
    solutions = measured.solutions()
    clean = measured.clean(solutions)
    angles = np.round(clean["th"] + 0.004 * rng.standard_normal(len(clean["th"])), 5)
    columns = {"t": np.concatenate([times] * len(runs)), "th": angles, "u": np.round(clean["u"], 4)}
    texts = {"run": [f"{number + 1}" for number in range(len(runs)) for _ in times],
             "mass": [run.group for run in runs for _ in times]}  # fmt: skip
    words = ("--trajectory", "run", "--group", "mass", "--inputs", "u", "--order", "2")
    return Drawn(f"motor, {rate:g} Hz", columns, words, measured.laws(), clean, lambda: measured.t(np.array([0.004])),
                 measured.predict, texts)  # fmt: skip


def _voltage(rng: np.random.Generator) -> Input:
    """Return a voltage: two waves, and one that is switched."""
    first, second, third = rng.uniform(0.0, 2.0 * math.pi, 3).tolist()
    return lambda time: (
        2.0 * math.sin(math.pi * time + first)
        + 1.5 * math.copysign(1.0, math.sin(2.0 * math.pi * 0.21 * time + second))
        + math.sin(2.0 * math.pi * 1.3 * time + third)
    )
