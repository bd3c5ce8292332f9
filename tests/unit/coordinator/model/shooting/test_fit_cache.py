"""What has been fitted before is not fitted again."""

import numpy as np

from atoll_coordinator.model.shooting.error_model import ErrorModel
from atoll_coordinator.model.shooting.fit_cache import FitCache, key_of
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.model.shooting.system import system_of
from tests.unit.coordinator.model.shooting.made import DECAY, measurements

TIMES = 0.1 * np.arange(20.0)


def decay(text="-0.4*x"):
    return system_of([DECAY.parsed(text)], DECAY.names, DECAY.names)


def test_what_is_kept_is_recalled_until_there_is_no_room():
    cache = FitCache[str](10, room_bytes=20)
    for number, fit in enumerate("abc"):
        cache.put((number,), fit)
    assert [cache.get((number,)) for number in range(3)] == [None, "b", "c"]


def test_a_key_differs_with_the_last_bit_of_a_constant_or_a_start():
    rows, starts = decay(), np.array([[3.0]])
    values = rows.values
    keys = {
        key_of(rows, starts, None, 3),
        key_of(rows, starts, None, 4),
        key_of(rows, starts, ErrorModel.independent(np.ones(1)), 3),
        key_of(rows, np.nextafter(starts, 4.0), None, 3),
        key_of(rows.with_values(np.nextafter(values, 1.0)), starts, None, 3),
        key_of(decay("-0.4*x*x"), starts, None, 3),
    }
    assert len(keys) == 6
    assert key_of(decay(), starts.copy(), None, 3) in keys


def test_the_same_fit_again_is_the_same_object_and_counts_the_same_work():
    estimator = MultipleShooting(measurements(DECAY, [[3.0], [2.0]], TIMES, noise=0.05), 1e-6)
    first = estimator.fit(decay(), 5, 4)
    work = estimator.work
    assert estimator.fit(decay(), 5, 4) is first
    assert estimator.work == 2 * work
    assert estimator.fit(decay(), 5, 3) is not first


def test_a_system_that_cannot_be_integrated_is_remembered_as_such():
    estimator = MultipleShooting(measurements(DECAY, [[3.0], [2.0]], TIMES), 1e-6)
    assert estimator.fit(decay("x*x*x"), None, 4) is None
    work = estimator.work
    assert estimator.fit(decay("x*x*x"), None, 4) is None
    assert estimator.work == 2 * work > 0


def test_sensitivities_are_those_of_finite_differences():
    estimator = MultipleShooting(measurements(DECAY, [[3.0], [2.0]], TIMES, noise=0.05), 1e-9)
    fit = estimator.fit(decay(), None, 10)
    little = 1e-5

    def moved(by: float) -> np.ndarray:
        system = fit.system.with_values(fit.system.values + by)
        return estimator.fit(system, None, 0, fit.starts, fit.errors).simulated[0]

    expected = (moved(little) - moved(-little)) / (2.0 * little)
    assert np.abs(fit.integrated_sensitivities()[:, 0, 0] - expected).max() < 1e-4 * np.abs(expected).max()
