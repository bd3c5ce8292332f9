"""Slow, obvious integration of a system of programs between rows, by scipy; inputs are cubics between rows."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline

from atoll_core.expression.program import Program
from tests.oracles.evaluate import evaluate

FloatArray = npt.NDArray[np.float64]


def integrate(
    programs: Sequence[Program], start: FloatArray, times: FloatArray, inputs: FloatArray, input_slopes: FloatArray
) -> FloatArray:
    """Return the states (D, R) at `times` (R,) of a system of D programs over D states, then U inputs (U, R)."""
    waves = [CubicHermiteSpline(times, *both) for both in zip(inputs, input_slopes, strict=True)]

    def rates(time: float, states: FloatArray) -> list[float]:
        point = [*states.tolist(), *(float(wave(time)) for wave in waves)]
        return [evaluate(program, point) for program in programs]

    columns = [np.asarray(start, dtype=np.float64)]
    for first, last in pairwise(times):
        with np.errstate(all="ignore"):
            solution = solve_ivp(rates, (first, last), columns[-1], "DOP853", rtol=1e-11, atol=1e-12)
        assert solution.success
        columns.append(solution.y[:, -1])
    return np.array(columns).T
