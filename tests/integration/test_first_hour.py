"""Tables as people hand them over in the first hour: whole jobs, from the file to the verdict, in one process.

The cases and what is made of their outcomes are those of `benchmarks.first_hour`; the service runs in virtual time,
with real islands, preparing and refining.
"""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.first_hour.campaign import is_as_it_should_be, line
from benchmarks.first_hour.cases import CASES
from tests.integration.whole_jobs import played

QUICK = [
    *("6 rows a period", "8 rows a period"),
    *(
        "decay",
        "growth",
        "ramp",
        "ramp down of whole numbers",
        "free fall",
        "tanh",
        "square",
        "two decays",
        "hyperbola",
    ),
    *("called sint, cost", "called lambda, class"),
    *("decay, 3 rows", "decay, 4 rows", "decay, 12 rows"),
    *("decay from 1e-30", "decay from 1e30", "decay in nanoseconds", "decay over millions of years"),
    "0 and 1 in turn",
]
LONGER = [
    *("5 rows a period", "10 rows a period", "relaxation to 20 degrees"),
    *("called None, nan", "called prey, grey, größe", "called dx, x"),
    *("1e-30 beside 1e30", "decay, 8 rows", "white noise, 8 rows", "3 rows a period"),
    *("a recording of an enzyme", "a recording of a damped swing"),
    *("delayed feedback", "a room with a thermostat, heater unknown", "metres and feet", "a column twice"),
    *("logistic map", "animals counted by ones"),
]


@pytest.mark.parametrize("name", [*QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in LONGER)])
def test_nothing_breaks_identified_laws_are_found_and_none_is_made_up(name: str, tmp_path: Path) -> None:
    with np.errstate(all="ignore"):  # as in the processes that do this
        outcome = played(CASES[name], tmp_path)
    assert is_as_it_should_be([outcome]), line(outcome)
    assert all(equation.is_found for equation in outcome.equations if equation.is_identified), line(outcome)


@pytest.mark.slow
def test_an_epidemic_with_noise_is_right_and_not_doubtful(tmp_path: Path) -> None:
    with np.errstate(all="ignore"):
        outcome = played(CASES["S + I + R = 1, 1 % of noise"], tmp_path)
    assert [(equation.is_found, equation.verdict) for equation in outcome.equations] == [(True, "good")] * 3, line(
        outcome
    )
