"""Models are solved from fresh initial conditions; those that run away or are too stiff end in time."""

import math

import numpy as np
import pytest

from benchmarks.harness.systems import SYSTEMS, drawn
from benchmarks.judging.generalisation import foretold, is_foretold
from benchmarks.noise.data import Path

TIMES = np.arange(50) * 0.1
GLIDER = Path(TIMES, drawn(SYSTEMS["glider"], np.random.default_rng(3), TIMES))
TRUTH = {"v": "-0.05*v**2 - sin(theta)", "theta": "v - cos(theta)/v"}


def test_the_truth_foretells_everything():
    r2 = foretold(TRUTH, [GLIDER])
    assert list(r2) == ["v", "theta"]
    assert min(r2.values()) > 1 - 1e-9


def test_a_wrong_equation_spoils_what_depends_on_it():
    r2 = foretold({**TRUTH, "v": "0.0*v"}, [GLIDER])
    assert r2["v"] < 0.9
    assert [is_foretold(value) for value in (r2["v"], None, 0.9, 0.91)] == [False, False, False, True]


def test_without_one_equation_nothing_is_foretold():
    assert foretold({**TRUTH, "v": None}, [GLIDER]) == {"v": -math.inf, "theta": -math.inf}


@pytest.mark.slow
@pytest.mark.parametrize(
    "expression",
    ["v**2", "1/(v - v)", "exp(50*v)", "log(-v)", "-1e9*(v - sin(1e6*theta))"],
    ids=["explosion", "division by zero", "overflow", "undefined", "stiff"],
)
def test_a_model_that_cannot_be_solved_has_no_r2(expression):
    assert foretold({"v": expression, "theta": "1.0"}, [GLIDER])["v"] == -math.inf


def test_an_equation_too_long_to_be_read_is_not_foretold():
    text = " + ".join(f"{number}.5*v" for number in range(300))
    assert foretold({"v": text, "theta": "1.0"}, [GLIDER]) == {"v": -math.inf, "theta": -math.inf}
