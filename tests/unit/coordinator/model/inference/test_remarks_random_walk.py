from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.data.recording import Recording, StateQuantisation, StateSmoothing, Trajectory
from atoll_coordinator.model.inference.remarks import warn_of_random_walk

TIMES = 0.05 * np.arange(1000)


def recording(states: np.ndarray) -> Recording:
    nothing = np.zeros((0, len(TIMES)))
    recorded = Trajectory("1", TIMES, states[None], states[None], states[None], nothing, nothing)
    return Recording(("x",), ("x",), (), (), (), 1, 0.0, (), (recorded,))


def remarks(measured: Recording, values: np.ndarray) -> list[str]:
    return warn_of_random_walk(measured, ("x",), [values[None]])


def walk(seed: int) -> np.ndarray:
    return np.cumsum(np.random.default_rng(seed).standard_normal(len(TIMES))) * 0.1


@pytest.mark.parametrize("seed", range(5))
def test_a_walk_about_a_simulation_proposes_the_option(seed: int) -> None:
    wave = 2.0 * np.sin(TIMES)
    assert "with --stochastic" in remarks(recording(wave + walk(seed)), wave)[0]
    assert "'x'" in warn_of_random_walk(recording(wave + walk(seed)))[0]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("slope", [0.0, 0.02, 0.05, 0.1, 0.2, 0.5, 2.0])
def test_errors_of_measurement_and_what_a_model_misses_do_not(seed: int, slope: float) -> None:
    wave = 2.0 * np.sin(TIMES)
    noise = 0.1 * np.random.default_rng(seed).standard_normal(len(TIMES))
    assert remarks(recording(wave + noise + slope * np.sin(2.0 * TIMES)), wave) == []


def test_errors_of_a_solver_do_not_though_they_add_up() -> None:
    wave = 2.0 * np.sin(TIMES)
    assert remarks(recording(wave + 1e-4 * walk(1)), wave) == []


def test_errors_of_rounding_do_not_though_they_stay_from_row_to_row() -> None:
    wave = 0.8 * np.sin(0.05 * TIMES) + 0.001 * walk(0)
    rounded = recording(np.round(wave))
    smoothing = StateSmoothing(
        "x", "loess", 0.3, 0.4, 9, 3, quantisation=StateQuantisation("steps", 1.0, 1.0 / 12.0**0.5)
    )
    assert remarks(replace(rounded, smoothing=(smoothing,)), wave) == []
    assert remarks(rounded, wave) != []
