"""Cascaded tanks by their physics: square roots as outflows, and overflow from the upper into the lower tank.

``dh/dt = k u - a sqrt(h + c) - overflow`` with h at most 10, ``dy/dt = b sqrt(h + c) + r overflow - e sqrt(y + d)``.
Nine numbers are fitted to the given rows from many starts by least squares, and the rest of the rows is forecast in
open loop. So the table tells what a law of this form, which no search had to find, can forecast from these rows.
"""

import math
from typing import Final

import numba
import numpy as np
from scipy.optimize import least_squares

from atoll_core.data.dataset import FloatArray
from benchmarks.harness.tables import markdown
from benchmarks.templates.forecasts import Case

_STEP: Final = 4.0
"""Seconds between rows."""
_PARTS: Final = 8
"""Euler steps from one row to the next."""
_FULL: Final = 10.0
_STARTS: Final = 60
_SHOWN: Final = 3
_NAMES: Final = ("k", "a", "b", "e", "r", "h(0)", "y(0)", "c", "d")
_FIRST: Final = np.array([0.05, 0.05, 0.05, 0.05, 0.3, 5.0, 5.2, 0.0, 0.0])
_SCALES: Final = np.array([0.05, 0.05, 0.05, 0.05, 0.3, 5.0, 5.0, 1.0, 1.0])


@numba.njit  # type: ignore[untyped-decorator]
def levels(numbers: FloatArray, inputs: FloatArray) -> FloatArray:
    """Return the level (N,) of the lower tank at each row, in volts of its sensor; `numbers` (9,) are k, a, b, e, r,
    the first levels of both tanks, c, and d, `inputs` (N,) the voltages of the pump."""
    k, a, b, e, r, h, y, c, d = numbers
    course, step = np.empty(len(inputs)), _STEP / _PARTS
    for row, u in enumerate(inputs):
        course[row] = min(y, _FULL)
        for _ in range(_PARTS):
            upper, lower = math.sqrt(max(h + c, 0.0)), math.sqrt(max(y + d, 0.0))
            rise, overflow = k * u - a * upper, 0.0
            if h >= _FULL and rise > 0.0:
                rise, overflow = 0.0, rise
            h = min(h + step * rise, _FULL)
            y = min(y + step * (b * upper + r * overflow - e * lower), _FULL)
    return course


def table_of_physics(case: Case, seed: int = 0) -> str:
    """Return the errors of the best fits to the given rows, on these rows and on the others, and of a fit to all rows,
    in Markdown."""
    inputs, measured, given = case.inputs["u"], case.measured, case.given

    def fitted(start: FloatArray, rows: int) -> FloatArray:
        found = least_squares(
            lambda numbers: levels(numbers, inputs[:rows]) - measured[:rows], start, x_scale=_SCALES, max_nfev=200,
            diff_step=1e-5,
        )  # fmt: skip
        return np.asarray(found.x)

    def errors(numbers: FloatArray) -> tuple[float, float]:
        squares = (levels(numbers, inputs) - measured) ** 2
        return float(np.sqrt(squares[:given].mean())), float(np.sqrt(squares[given:].mean()))

    rng, fits = np.random.default_rng(seed), []
    for _ in range(_STARTS):
        start = _FIRST * np.exp(0.5 * rng.standard_normal(len(_FIRST)))
        start[-3:] = measured[0], *(0.5 * rng.standard_normal(2))
        fits.append(fitted(start, given))
    best = sorted(fits, key=errors)[:_SHOWN]
    named = [("given rows", numbers) for numbers in best]
    named.append(("all rows", fitted(best[0], len(measured))))
    rows = [
        (name, *(f"{error:.3f}" for error in errors(numbers)), *(f"{number:.3g}" for number in numbers.tolist()))
        for name, numbers in named
    ]
    return markdown(("fitted to", "RMSE of given rows, V", "of the other rows, V", *_NAMES), rows)
