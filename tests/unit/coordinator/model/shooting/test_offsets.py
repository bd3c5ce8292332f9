"""States that are measured up to an offset of each trajectory."""

from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.model.inference.final_model import estimate_errors
from atoll_coordinator.model.inference.trajectory_simulation import simulated_states
from atoll_coordinator.model.shooting.measurements import measurements_of
from tests.unit.coordinator.model.shooting.made import LOTKA, LOTKA_TEXT, compare, recording

TIMES = 0.1 * np.arange(60.0)
STARTS = [[0.4, 1.5], [1.5, 0.3], [0.2, 0.4]]
OFFSETS = (0.5, -0.3, 0.0)


@pytest.fixture
def rows():
    made = recording(LOTKA, STARTS, TIMES, 0.01)
    moved = tuple(
        replace(trajectory, measured=trajectory.measured + np.array([[offset], [0.0]]))
        for trajectory, offset in zip(made.trajectories, OFFSETS, strict=True)
    )
    return measurements_of(replace(made, trajectories=moved, offsets=("x",)), range(2))


def test_offsets_are_fitted_with_whole_trajectories(rows):
    task = compare(LOTKA, rows)
    model = task.fit_model([LOTKA.parsed(text) for text in LOTKA_TEXT])
    assert model.fit.starts.shape == (3, 3)
    assert model.fit.starts[:, 2] == pytest.approx(OFFSETS, abs=0.02)
    assert np.sqrt(model.fit.squares) == pytest.approx([0.01, 0.01], rel=0.15)
    values, offsets = simulated_states(rows, model.fit, ("x", "y"))
    assert offsets["x"][::60] == pytest.approx(OFFSETS, abs=0.02)
    assert set(offsets) == {"x"}
    assert values[0] == pytest.approx(rows.measured[0], abs=0.06)


def test_offsets_count_as_fitted_numbers(rows):
    task = compare(LOTKA, rows)
    model = task.fit_model([LOTKA.parsed(text) for text in LOTKA_TEXT])
    assert estimate_errors(task, model).degrees_of_freedom == 360 - len(model.fit.system.places) - 9


def test_segments_have_none(rows):
    task = compare(LOTKA, rows)
    model = task.fit_model([LOTKA.parsed(text) for text in LOTKA_TEXT], lengths=(10,))
    assert model.fit.starts.shape == (18, 2)


def test_without_offsets_the_same_trajectories_are_not_fitted(rows):
    task = compare(LOTKA, replace(rows, offset=rows.offset[:0]))
    model = task.fit_model([LOTKA.parsed(text) for text in LOTKA_TEXT])
    assert model is None or model.fit.squares[0] > 1e-3
