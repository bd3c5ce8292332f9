"""States under inputs held between rows: slopes by piece or by difference, paired with the input that acted."""

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_core.config import DataConfig, JobConfig
from atoll_core.errors import UsageError
from tests.unit.coordinator.data.tables import table_of


def driven(rows, hold, step, noise=0.0, seed=3):
    """Return x' = 2 u - 0.7 x under an input of two levels that changes at most every `hold` rows, solved exactly."""
    random = np.random.default_rng(seed)
    u = np.repeat(random.integers(0, 2, rows // hold + 1), hold)[:rows].astype(float)
    x, share = np.zeros(rows), np.exp(-0.7 * step)
    for row in range(rows - 1):
        x[row + 1] = x[row] * share + 2.0 * u[row] / 0.7 * (1.0 - share)
    return {"t": step * np.arange(rows), "x": x + noise * random.standard_normal(rows), "u": u}


def prepared(columns, **options):
    return prepare(table_of(columns), JobConfig(data=DataConfig(inputs=("u",), **options)))


@pytest.mark.parametrize(("hold", "step"), [(1, 0.3), (2, 0.2), (20, 0.1)])
def test_the_search_sees_the_slope_of_the_law(hold, step):
    dataset = prepared(driven(200, hold, step), hold=("u",)).dataset
    x, u = dataset.inputs
    assert len(x) > 100
    assert dataset.targets[0].values == pytest.approx(2.0 * u - 0.7 * x, abs=0.01)
    if hold < 20:  # rows near few switches are left out anyway
        smoothed = prepared(driven(200, hold, step)).dataset
        x, u = smoothed.inputs
        assert np.abs(smoothed.targets[0].values - 2.0 * u + 0.7 * x).max() > 0.1


@pytest.mark.parametrize(("hold", "step"), [(1, 0.3), (20, 0.1)])
def test_the_noise_is_that_of_the_measurements(hold, step):
    recording = prepared(driven(300, hold, step, noise=0.01), hold=("u",)).recording
    assert recording.smoothing[0].noise == pytest.approx(0.01, rel=0.2)


def test_a_held_input_has_no_slopes_and_others_do():
    columns = driven(100, 20, 0.1) | {"w": np.sin(0.1 * np.arange(100))}
    options = DataConfig(states=("x",), inputs=("u", "w"), hold=("u",))
    recording = prepare(table_of(columns), JobConfig(data=options)).recording
    assert recording.input_kinds == ("held", "smooth")
    assert np.isnan(recording.trajectories[0].input_slopes).all(axis=1).tolist() == [True, False]


def test_smoothed_slopes_stay_where_noise_hides_the_differences():
    columns = driven(300, 2, 0.01, noise=0.02)
    held, smoothed = (prepared(columns, **options).dataset.targets[0] for options in ({"hold": ("u",)}, {}))
    assert held.values.tolist() == smoothed.values.tolist()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"hold": ("x",)}, "--hold names 'x', but the inputs are u"),
        ({"hold": ("u",), "target": "x"}, "hold and target exclude each other"),
        ({"hold": ("u",), "stochastic": True}, "hold and stochastic exclude each other"),
    ],
)
def test_what_cannot_be_held_is_refused(options, message):
    with pytest.raises(UsageError, match=message):
        prepared(driven(50, 5, 0.1), **options)
