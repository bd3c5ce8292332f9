"""Intervals of laws that are fitted as they are: drawn alike from a seed, and counted."""

import numpy as np
import pytest

from benchmarks.noise.intervals import LAWS, drawn, fit


def test_errors_of_neighbours_are_correlated_as_named() -> None:
    law = LAWS["cooling"]
    columns = drawn(law, 20_000, "ar1", 0.1, 3)
    errors = columns["x"] - law.solution(columns["t"])
    assert np.corrcoef(errors[:-1], errors[1:])[0, 1] == pytest.approx(0.6, abs=0.03)


def test_the_constants_of_the_law_are_judged() -> None:
    made = fit(LAWS["logistic"], drawn(LAWS["logistic"], 30, "independent", 0.01, 5))
    assert made is not None
    assert len(made.holds) == 2
    assert not made.are_correlated
