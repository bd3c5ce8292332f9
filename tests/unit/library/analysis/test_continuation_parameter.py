"""What users name is what varies: constants, coefficients that nobody writes, inputs."""

import numpy as np
import pytest

from atoll.analysis.continuation import Coefficients
from atoll.analysis.flow import Flow
from atoll.model.vector_field import VectorField
from atoll_core.errors import UsageError

FIELD = VectorField.of({"x": "x*(3.0 - x - 2.0*y) + u", "y": "y*(2.0 - x - y) - 2.0*sin(y)"}, ["u"])
COEFFICIENTS = Coefficients.of(FIELD)
FLOW = Flow.of(FIELD, np.array([0.5]))
POINT = np.array([[1.3, 0.7]])


@pytest.mark.parametrize(
    ("name", "value", "slope"),
    [
        ("c1", 3.0, (1.3, 0.0)),
        ("2", 2.0, (-2.0 * 0.7 * 0.65, 0.0)),
        ("y:x*y", 1.0, (0.0, -0.91)),
        ("y:y*x", 1.0, (0.0, -0.91)),
        ("x**2", 1.0, (-1.69, 0.0)),
        ("x:x*y", 2.0, (-0.91, 0.0)),
        ("c3", 2.0, (0.0, 0.7 - np.sin(0.7))),  # one number of the text in two places
        ("sin(y)", 2.0, (0.0, -np.sin(0.7))),
        ("c1,c2", 3.0, (1.3 - 0.91 * 2.0 / 3.0, 0.0)),
        ("u", 0.5, (1.0, 0.0)),
    ],
)
def test_a_name_says_what_varies(name: str, value: float, slope: tuple[float, float]) -> None:
    flow, parameter = COEFFICIENTS.find(FLOW, name)
    np.testing.assert_allclose(flow.rates(POINT), FLOW.rates(POINT))
    assert parameter.value == value
    np.testing.assert_allclose(parameter.slope(flow, POINT)[0], slope, atol=1e-15)
    moved = (parameter.at(flow, value + 1e-3).rates(POINT) - FLOW.rates(POINT)) / 1e-3
    np.testing.assert_allclose(moved[0], slope, atol=1e-9)


def test_factors_of_one_have_names() -> None:
    assert COEFFICIENTS.units == ("x:x**2", "x:u", "y:x*y", "y:y**2")


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("x*y", "'x\\*y' occurs in several equations"),
        ("c9", "no parameter 'c9'; the model has c1 = 3 of x, .*you can also vary x:x"),
        ("y:cos(x)", "no parameter"),
        ("", "no parameter"),
    ],
)
def test_what_is_not_there_is_refused(name: str, sentence: str) -> None:
    with pytest.raises(UsageError, match=sentence):
        COEFFICIENTS.find(FLOW, name)
