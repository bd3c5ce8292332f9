"""States that are measured up to an offset of each trajectory."""

from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.model.inference.standard_errors import estimate_errors
from atoll_coordinator.model.inference.trajectory_simulation import simulated
from atoll_coordinator.model.shooting.measurements import measurements_of
from tests.unit.coordinator.model.shooting.made import LOTKA, LOTKA_TEXT, compare, recording

TIMES = 0.1 * np.arange(60.0)
STARTS = [[0.4, 1.5], [1.5, 0.3], [0.2, 0.4]]
OFFSETS = (0.5, -0.3, 0.0)


@pytest.fixture
def its():
    made = recording(LOTKA, STARTS, TIMES, 0.01)
    moved = tuple(
        replace(each, measured=each.measured + np.array([[offset], [0.0]]))
        for each, offset in zip(made.trajectories, OFFSETS, strict=True)
    )
    return measurements_of(replace(made, trajectories=moved, offsets=("x",)), range(2))


def test_offsets_are_fitted_with_whole_trajectories(its):
    task = compare(LOTKA, its)
    model = task.fit_model([LOTKA.parsed(text) for text in LOTKA_TEXT])
    assert model.fit.starts.shape == (3, 3)
    assert model.fit.starts[:, 2] == pytest.approx(OFFSETS, abs=0.02)
    assert np.sqrt(model.fit.squares) == pytest.approx([0.01, 0.01], rel=0.15)
    curves = simulated(its, model.fit, None, ("x", "y"), held_out=False)
    assert [curve.offsets["x"] for curve in curves] == pytest.approx(OFFSETS, abs=0.02)
    assert set(curves[0].offsets) == {"x"}
    assert curves[0].values[0] == pytest.approx(its.measured[0, :60], abs=0.06)


def test_offsets_count_as_fitted_numbers(its):
    task = compare(LOTKA, its)
    model = task.fit_model([LOTKA.parsed(text) for text in LOTKA_TEXT])
    assert estimate_errors(task, model).degrees_of_freedom == 360 - len(model.fit.system.places) - 9


def test_segments_have_none(its):
    task = compare(LOTKA, its)
    model = task.fit_model([LOTKA.parsed(text) for text in LOTKA_TEXT], lengths=(10,))
    assert model.fit.starts.shape == (18, 2)


def test_without_offsets_the_same_trajectories_are_not_fitted(its):
    task = compare(LOTKA, replace(its, offset=its.offset[:0]))
    model = task.fit_model([LOTKA.parsed(text) for text in LOTKA_TEXT])
    assert model is None or model.fit.squares[0] > 1e-3
