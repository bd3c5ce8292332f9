"""What a configuration leaves open is filled in from the data."""

from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.data.differentiation.kernels.stencils import HALF_WIDTHS
from atoll_coordinator.data.recording import STENCIL_ROWS, Recording, StateSmoothing
from atoll_coordinator.service.jobs.job import (
    STAGNATION_CLEAN,
    STAGNATION_GIVEN,
    STAGNATION_NOISY,
    independent_rows,
    stagnation_of,
)
from atoll_coordinator.service.search.ending import Stagnation
from atoll_coordinator.tasks.defaults import RUNNERS_UP_NOISY, resolve
from atoll_core.config import PAPER, BudgetConfig, EvolutionConfig, JobConfig, PredictorConfig, SpaceConfig
from atoll_core.data.dataset import Dataset, Target

RECORDING = Recording(("x0",), ("x0",), (), (), (), 1, 0.0, (StateSmoothing("x0", "interpolation", 0.0, 0.0),), ())


def dataset(variables: int = 2, floor: float = 1e-9, noise: float = 0.0) -> Dataset:
    names = tuple(f"x{index}" for index in range(variables))
    values = np.linspace(0.0, 1.0, 10)
    clean = Target(names[0], "dx0/dt", values, 1e-9, 1.0)
    other = Target(names[-1], "dx/dt", values, floor, 1.0, noise)
    return Dataset(names, np.stack([values] * variables), (clean, other), {name: name for name in names})


def test_clean_data_need_16_rows_and_noisy_ones_32() -> None:
    assert resolve(JobConfig(), dataset()).predictors.rows == 16
    assert resolve(JobConfig(), dataset(floor=0.01)).predictors.rows == 32
    assert resolve(JobConfig(), dataset(noise=0.01)).predictors.rows == 32


def test_runners_up_are_kept_as_soon_as_one_target_is_noisy() -> None:
    assert resolve(JobConfig(), dataset()).evolution.runners_up == 0
    assert resolve(JobConfig(), dataset(floor=0.01)).evolution.runners_up == RUNNERS_UP_NOISY
    assert resolve(JobConfig(), dataset(noise=0.01)).evolution.runners_up == RUNNERS_UP_NOISY


def test_the_search_for_a_noisy_target_stagnates_sooner_and_that_for_a_clean_one_beside_it_does_not() -> None:
    targets = dataset(noise=0.01).targets
    epochs = [stagnation_of(JobConfig(), target, RECORDING) for target in targets]
    assert epochs == [Stagnation(STAGNATION_CLEAN, grows=True), Stagnation(STAGNATION_NOISY)]
    given = [stagnation_of(JobConfig(), target, None) for target in targets]
    assert given == [Stagnation(STAGNATION_GIVEN), Stagnation(STAGNATION_NOISY)]


def test_rows_that_count_are_those_with_errors_of_their_own() -> None:
    target = dataset().targets[0]
    assert independent_rows(target, None) == len(target.values)
    assert independent_rows(target, RECORDING) == len(target.values) / STENCIL_ROWS
    smoothed = replace(RECORDING, smoothing=(StateSmoothing(target.variable, "loess", 0.1, 0.1, span=20, degree=3),))
    assert independent_rows(target, smoothed) == pytest.approx(len(target.values) / 5.0)
    narrow = replace(RECORDING, smoothing=(StateSmoothing(target.variable, "loess", 0.1, 0.1, span=4, degree=4),))
    assert independent_rows(target, narrow) == len(target.values)


def test_terminals_grow_with_the_variables() -> None:
    assert [resolve(JobConfig(), dataset(count)).space.terminals for count in (1, 2, 3, 9)] == [7, 7, 8, 14]


def test_what_is_given_stands() -> None:
    config = JobConfig(
        predictors=PredictorConfig(rows=20),
        space=SpaceConfig(terminals=9),
        evolution=EvolutionConfig(runners_up=0),
        budget=BudgetConfig(stagnation=7),
    )
    assert resolve(config, dataset(noise=0.1)) == config
    epochs = [stagnation_of(config, target, RECORDING) for target in dataset(noise=0.1).targets]
    assert epochs == [Stagnation(7), Stagnation(7)]
    assert resolve(PAPER, dataset(9, noise=0.1)) == PAPER
    assert stagnation_of(PAPER, dataset(noise=0.1).targets[1], RECORDING) == Stagnation(500)


def test_a_clean_target_has_an_error_of_its_own_in_each_of_the_widest_stencils():
    assert STENCIL_ROWS == 2 * HALF_WIDTHS + 1
