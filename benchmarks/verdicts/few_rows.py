"""Tables of 5 to 12 rows: eight laws and a control without one; 0, 1 and 3 % of noise, rounded as people write."""

from typing import Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from benchmarks.first_hour.tables import drawn as without_law
from benchmarks.harness.solving import DivergedError
from benchmarks.verdicts.drawn import FRESH, Drawn, Measured, nice_step, rounded, with_errors
from benchmarks.verdicts.laws import LAWS, Law
from benchmarks.verdicts.simulation import Run

CONTROL: Final = "no law"
KINDS: Final = (*LAWS, CONTROL)
LEVELS: Final = (0.0, 0.01, 0.03)
ROWS: Final = (5, 12)
DIGITS: Final = (2, 4)
_UNEVEN: Final = 0.25
"""Share of the tables whose rows are not evenly spaced, as of people who look more often in the beginning."""


def draw(seed: int, _variant: str = "") -> Drawn:
    """Return the table of a seed: kinds in turn, and for each kind the levels of noise in turn."""
    kind, level = KINDS[seed % len(KINDS)], LEVELS[seed // len(KINDS) % len(LEVELS)]
    rng = np.random.default_rng([seed, 101])
    rows = int(rng.integers(ROWS[0], ROWS[1] + 1))
    digits = int(rng.integers(DIGITS[0], DIGITS[1] + 1))
    if kind == CONTROL:
        return _control(rows, digits, seed)
    while True:
        try:
            return _measured(kind, LAWS[kind], rows, level, digits, rng)
        except DivergedError:
            continue


def _control(rows: int, digits: int, seed: int) -> Drawn:
    how = ("walk", "white", "uniform")[seed // len(KINDS) % 3]
    columns = without_law(rows, seed, x=how)
    columns["t"] = np.arange(rows, dtype=np.float64)
    columns["x"] = rounded(columns["x"], digits)[0]
    return Drawn(f"{CONTROL}: {how}", columns, (), {"": {"x": None}})


def _measured(kind: str, law: Law, rows: int, level: float, digits: int, rng: np.random.Generator) -> Drawn:
    constants = law.draw_constants(rng)
    times = _times(law.draw_duration(constants, rng), rows, rng)
    run = Run(constants, law.draw_start(constants, rng), times)
    measured = Measured(law.equations, [run], [], law.measured, order=law.order)
    (states,) = measured.solutions()
    whole = Measured(law.equations, [run], fresh(run, states, rng), law.measured, order=law.order)
    kept = states[:, [place for place, state in enumerate(law.equations) if state in law.measured]]
    (noisy,), errors = with_errors([kept], level, digits, rng)
    columns = {"t": times, **dict(zip(law.measured, noisy.T, strict=True))}
    words = ("--order", "2") if law.order == 2 else ()
    return Drawn(
        f"{kind}, {level:.0%}",
        columns,
        words,
        whole.laws(),
        whole.clean([states]),
        lambda: whole.t(errors),
        whole.predict,
        decide=lambda: whole.leads(columns, errors),
    )


def _times(duration: float, rows: int, rng: np.random.Generator) -> FloatArray:
    """Return times in round steps, in a quarter of the tables denser at the beginning."""
    if rng.random() < _UNEVEN:
        steps = np.sort(rng.choice([1.0, 1.0, 2.0, 2.0, 3.0], rows - 1))
        return np.array(np.concatenate([[0.0], np.cumsum(steps * nice_step(duration / steps.sum()))]))
    return np.arange(rows, dtype=np.float64) * nice_step(duration / (rows - 1))


def fresh(run: Run, states: FloatArray, rng: np.random.Generator) -> list[Run]:
    """Return runs from other initial states between the least and the largest of the states (n, S)."""
    low, high = states.min(axis=0), states.max(axis=0)
    return [
        Run(run.constants, tuple(rng.uniform(low, high).tolist()), run.times, run.inputs, run.is_held,
               run.group)
        for _ in range(FRESH)
    ]  # fmt: skip
