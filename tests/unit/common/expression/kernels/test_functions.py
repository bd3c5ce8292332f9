"""Functions over a block of rows have the same bits on every lane as the functions of one number."""

import math

import numpy as np
import pytest

from atoll_core.compilation.jit import kernel
from atoll_core.expression.kernels.elementary import (
    strict_cos,
    strict_exp,
    strict_log,
    strict_pow,
    strict_sin,
    strict_tanh,
)
from atoll_core.expression.kernels.functions import LEFT, RIGHT, apply_function, functions_address
from atoll_core.expression.kernels.lanes import LANES, place
from atoll_core.expression.operators import ABS, COS, EXP, LOG, POW, SIN, TANH

AWKWARD = [0.0, -0.0, 1.0, -1.0, 0.5, 3.0, -2.0, 1e-300, 5e-324, 1e200, 1e5, -1.1e5, math.inf, -math.inf, math.nan]
FUNCTIONS = {
    SIN: lambda a, b: strict_sin(a),
    COS: lambda a, b: strict_cos(a),
    EXP: lambda a, b: strict_exp(a),
    LOG: lambda a, b: strict_log(a),
    TANH: lambda a, b: strict_tanh(a),
    POW: strict_pow,
    LEFT + ABS: lambda a, b: float((a > 0.0) - (a < 0.0)),
    LEFT + POW: lambda a, b: b * strict_pow(a, b - 1.0),
    RIGHT + POW: lambda a, v: v * (0.0 if a == 0.0 == v else strict_log(a)),
}


@pytest.fixture(autouse=True)
def _quiet():
    """Silence numpy's warnings: infinities and NaN are expected here."""
    with np.errstate(all="ignore"):
        yield


@kernel
def applied(address: int, operator: int, out, a, b, start: int) -> None:
    apply_function(address, operator, place(out, 0, start), place(a, 0, start), place(b, 0, start))


def assert_lanes(operator, a, b):
    arrays = np.full((3, 1, 3 * LANES), 7.5)
    arrays[1, 0, LANES : 2 * LANES], arrays[2, 0, LANES : 2 * LANES] = a, b
    applied(functions_address(), operator, arrays[0], arrays[1], arrays[2], LANES)
    values = arrays[0, 0, LANES : 2 * LANES]
    expected = np.array([FUNCTIONS[operator](x, y) for x, y in zip(a.tolist(), b.tolist(), strict=True)])
    np.testing.assert_array_equal(values, expected)
    numbers = ~np.isnan(expected)
    np.testing.assert_array_equal(np.signbit(values)[numbers], np.signbit(expected)[numbers])
    assert (np.delete(arrays[0, 0], np.s_[LANES : 2 * LANES]) == 7.5).all()


@pytest.mark.parametrize("operator", FUNCTIONS)
def test_every_lane_has_the_bits_of_the_function_of_one_number(operator):
    random = np.random.default_rng(operator)
    for scale in (1e-3, 1.0, 30.0, 2e4):
        assert_lanes(operator, *(scale * random.normal(size=(2, LANES))))
        assert_lanes(operator, abs(scale * random.normal(size=LANES)), random.normal(size=LANES))


@pytest.mark.parametrize("operator", FUNCTIONS)
def test_awkward_numbers_have_no_influence_on_their_neighbours(operator):
    for turn in range(len(AWKWARD)):
        assert_lanes(operator, np.resize(AWKWARD, LANES), np.resize(np.roll(AWKWARD, turn), LANES))
