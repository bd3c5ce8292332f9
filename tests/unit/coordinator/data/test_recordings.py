"""The recording: all measurements, and how they were smoothed."""

import math

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_core.config import Angle, DataConfig, JobConfig
from tests.unit.coordinator.data.tables import oscillator, table_of


def prepared(columns, starts=(0,), preset="default", **options):
    return prepare(table_of(columns, starts), JobConfig(preset=preset, data=DataConfig(**options)))


def recorded(columns, starts=(0,), preset="default", **options):
    recording = prepared(columns, starts, preset, **options).recording
    assert recording is not None
    return recording


def noisy(rows=200, noise=0.05):
    columns = oscillator(rows)
    rng = np.random.default_rng(0)
    return columns | {name: columns[name] + noise * rng.standard_normal(rows) for name in ("x", "y")}


def test_every_row_is_recorded_as_it_was_measured():
    """Of clean data the search sees fewer rows."""
    columns = oscillator(100, start=1900.0)
    recording = recorded(columns)
    (trajectory,) = recording.trajectories
    assert (recording.states, recording.state_symbols, recording.velocity_symbols) == (("x", "y"), ("x", "y"), ())
    assert (recording.inputs, recording.input_symbols, recording.order) == ((), (), 1)
    assert trajectory.times + recording.offset == pytest.approx(columns["t"], abs=1e-9)
    assert trajectory.measured.tolist() == [columns["x"].tolist(), columns["y"].tolist()]
    assert trajectory.smoothed.tolist() == trajectory.measured.tolist()
    assert trajectory.slopes[:, 4:-4] == pytest.approx(np.array([columns["y"], -columns["x"]])[:, 4:-4], abs=1e-9)
    assert trajectory.inputs.shape == trajectory.input_slopes.shape == (0, 100)
    assert not trajectory.held_out


def test_arrays_are_in_c_order():
    columns = noisy(50)
    columns["u"] = columns["t"] ** 2
    for trajectory in recorded(columns, (0, 20), inputs=("u", "t")).trajectories:
        for array in (
            trajectory.times,
            trajectory.measured,
            trajectory.smoothed,
            trajectory.slopes,
            trajectory.inputs,
            trajectory.input_slopes,
        ):
            assert array.flags.c_contiguous


def test_how_noisy_states_were_smoothed():
    columns = noisy()
    recording = recorded(columns)
    for name, smoothing, smoothed in zip("xy", recording.smoothing, recording.trajectories[0].smoothed, strict=True):
        assert (smoothing.state, smoothing.method) == (name, "loess")
        assert smoothing.noise == pytest.approx(0.05, rel=0.15)
        assert smoothing.relative_noise == pytest.approx(smoothing.noise / np.std(columns[name]))
        assert smoothing.span is not None
        assert smoothing.span > 10
        assert smoothing.degree in (3, 4)
        assert np.std(smoothed - oscillator(200)[name]) < 0.025


def test_inputs_are_recorded_with_their_slopes():
    columns = oscillator(100, start=5.0)
    columns["u v"] = columns["t"] ** 2
    recording = recorded(columns, inputs=("u v", "t"))
    (trajectory,) = recording.trajectories
    assert (recording.inputs, recording.input_symbols) == (("u v", "t"), ("u_v", "t"))
    assert trajectory.inputs.tolist() == [columns["u v"].tolist(), columns["t"].tolist()]
    assert trajectory.input_slopes[0] == pytest.approx(2 * columns["t"])
    assert trajectory.input_slopes[1].tolist() == [1.0] * 100


def test_angles_are_recorded_unwrapped_and_in_radians():
    columns = oscillator(100)
    columns["y"] = np.degrees(3 * columns["t"]) % 360
    columns["u"] = (2 * columns["t"]) % (2 * math.pi)
    recording = recorded(columns, inputs=("u",), angles=(Angle(column="y", degrees=True), Angle(column="u")))
    assert recording.trajectories[0].measured[1] == pytest.approx(3 * columns["t"])
    assert recording.trajectories[0].inputs[0] == pytest.approx(2 * columns["t"])
    assert recording.trajectories[0].input_slopes[0] == pytest.approx(np.full(100, 2.0))
