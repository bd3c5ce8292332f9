import numpy as np
import pytest

from atoll_coordinator.stochastic.jets import jet_of
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.text.parsing import from_infix

NAMES = ["x", "y", "u"]


@pytest.mark.parametrize(
    "text",
    [
        "x*y*u - x/y + 3",
        "sin(x*y) + cos(x - u)",
        "exp(-x)*log(y) + sqrt(x*y)",
        "tanh(x/2)*abs(y) + x**2.5",
        "1/(x + y**2) - x**y",
        "2.5",
    ],
)
def test_derivatives_are_those_of_central_differences(text: str) -> None:
    program = from_infix(text, NAMES)
    points = 0.5 + np.random.default_rng(1).random((3, 7))
    jet, step = jet_of(program, points, 2), 1e-4

    def value(i: int, j: int, a: float, b: float) -> np.ndarray:
        moved = points.copy()
        moved[i] += a * step
        moved[j] += b * step
        return values_of(program, moved)

    assert np.allclose(jet.value, values_of(program, points), rtol=1e-13)
    gradient, hessian = np.broadcast_to(jet.gradient, (2, 7)), np.broadcast_to(jet.hessian, (2, 2, 7))
    for i in range(2):
        slope = (value(i, i, 0.5, 0.5) - value(i, i, -0.5, -0.5)) / (2.0 * step)
        assert np.allclose(gradient[i], slope, atol=1e-6)
        for j in range(2):
            corners = value(i, j, 1, 1) - value(i, j, 1, -1) - value(i, j, -1, 1) + value(i, j, -1, -1)
            assert np.allclose(hessian[i, j], corners / (4.0 * step * step), atol=1e-5)
