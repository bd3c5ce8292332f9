"""Tables for ``--target y`` of 5 to 40 rows: laws, and in a third of the tables none.

Without a law: random numbers, the values of a law in another order, and three distinct x values with a level each.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from benchmarks.first_hour.tables import Columns
from benchmarks.judging.errors import error_on, values_on
from benchmarks.verdicts.drawn import Drawn, Predictions, rounded
from benchmarks.verdicts.simulation import CONSTANT, with_numbers

TARGET: Final = "y"
ROWS: Final = (5, 40)
LEVELS: Final = (0.0, 0.01, 0.03, 0.1)
LAWLESS: Final = ("random numbers", "shuffled", "three x values")
FRESH_POINTS: Final = 400
BEYOND: Final = 0.5
"""Of its width, by which a range is extended to judge predictions beyond what was measured."""

_SHIFT: Final = 1e-4


@dataclass(frozen=True)
class Curve:
    """A function of columns with constants, their ranges, and the range of each column."""

    text: str
    constants: Mapping[str, tuple[float, float]]
    ranges: Mapping[str, tuple[float, float]]


_X: Final = {"x": (0.2, 6.0)}
CURVES: Final = {
    "line": Curve("k1 + k2*x", {"k1": (0.5, 5.0), "k2": (0.3, 3.0)}, _X),
    "parabola": Curve("k1 + k2*x - k3*x**2", {"k1": (0.5, 5.0), "k2": (0.5, 3.0), "k3": (0.1, 1.0)}, _X),
    "saturation": Curve("k1*x/(k2 + x)", {"k1": (1.0, 9.0), "k2": (0.3, 3.0)}, _X),
    "decay": Curve("k1*exp(-k2*x)", {"k1": (1.0, 9.0), "k2": (0.2, 1.0)}, _X),
    "power": Curve("k1*x**k2", {"k1": (0.5, 3.0), "k2": (1.3, 2.7)}, _X),
    "wave": Curve("k1 + k2*sin(k3*x)", {"k1": (0.5, 3.0), "k2": (0.5, 3.0), "k3": (0.8, 2.0)}, _X),
    "reciprocal": Curve("k1 + k2/x", {"k1": (0.5, 3.0), "k2": (0.5, 3.0)}, _X),
    "product": Curve("k1*x*z + k2*z", {"k1": (0.5, 3.0), "k2": (0.5, 3.0)}, {"x": (0.2, 4.0), "z": (-2.0, 2.0)}),
}


def draw(seed: int, _variant: str = "") -> Drawn:
    """Return the table of a seed; each third one has no law."""
    rng = np.random.default_rng([seed, 102])
    rows = int(rng.integers(ROWS[0], ROWS[1] + 1))
    digits = int(rng.integers(3, 5))
    turn, is_lawless = seed // 3, seed % 3 == 2
    names = [*CURVES]
    name = names[(2 * turn + seed % 3) % len(names)]
    curve, level = CURVES[name], LEVELS[turn // len(LEVELS) % len(LEVELS)]
    constants = {key: float(f"{rng.uniform(*bounds):.2g}") for key, bounds in curve.constants.items()}
    columns = {key: rounded(rng.uniform(*bounds, rows), 3)[0] for key, bounds in curve.ranges.items()}
    law = with_numbers({TARGET: curve.text}, constants)[TARGET]
    if is_lawless:
        kind = LAWLESS[turn % len(LAWLESS)]
        columns, values = _lawless(kind, columns, values_on(law, columns), rng)
        return Drawn(kind, {**columns, TARGET: rounded(values, digits)[0]}, ("--target", TARGET), {"": {TARGET: None}})
    clean = values_on(law, columns)
    spread = level * float(clean.std())
    values, step = rounded(clean + spread * rng.standard_normal(rows), digits)
    error = float(np.hypot(spread, step))
    points, beyond = (_points(columns, wider, rng) for wider in (0.0, BEYOND))

    def predict(models: Mapping[str, Mapping[str, str | None]]) -> Predictions:
        text = models[""].get(TARGET)
        return {TARGET: (_r2(text, law, points), _r2(text, law, beyond))}

    return Drawn(
        f"{name}, {level:.0%}", {**columns, TARGET: values}, ("--target", TARGET), {"": {TARGET: law}}, columns,
        lambda: {TARGET: _t(curve.text, constants, columns, error)}, predict,
    )  # fmt: skip


def _points(columns: Columns, wider: float, rng: np.random.Generator) -> Columns:
    """Return points of the range of each column, which is made `wider` by a share of its width at its upper end."""
    return {
        key: rng.uniform(column.min(), column.max() + wider * np.ptp(column), FRESH_POINTS)
        for key, column in columns.items()
    }


def _r2(text: str | None, law: str, points: Columns) -> float:
    error = None if text is None else error_on(text, law, points)
    return -np.inf if error is None else 1.0 - error**2


def _lawless(
    kind: str, columns: Columns, values: FloatArray, rng: np.random.Generator
) -> tuple[Columns, FloatArray]:  # fmt: skip
    if kind == "random numbers":
        return columns, rng.standard_normal(len(values))
    if kind == "shuffled":
        return columns, rng.permutation(values)
    places = np.arange(len(values)) % 3
    levels = rng.uniform(-3.0, 3.0, 3)
    ends = {key: (float(column.min()), float(column.max())) for key, column in columns.items()}
    few = {key: np.round(np.linspace(low, high, 3), 1)[places] for key, (low, high) in ends.items()}
    return few, levels[places] + 0.03 * rng.standard_normal(len(values))


def _t(text: str, constants: Mapping[str, float], columns: Columns, error: float) -> float:
    """Return the least estimate over standard error that a constant can have."""
    base = values_on(with_numbers({TARGET: text}, constants)[TARGET], columns)
    effects = []
    for name in dict.fromkeys(CONSTANT.findall(text)):
        changed = {**constants, name: constants[name] * (1.0 + _SHIFT)}
        effects.append((values_on(with_numbers({TARGET: text}, changed)[TARGET], columns) - base) / (_SHIFT * error))
    singular, directions = np.linalg.svd(np.array(effects).T, full_matrices=False)[1:]
    variances = ((directions / np.maximum(singular, 1e-12)[:, None]) ** 2).sum(axis=0)
    return float(1.0 / np.sqrt(variances.max()))
