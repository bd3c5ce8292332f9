"""What a configuration leaves open is filled in from the data."""

import numpy as np

from atoll.config import PAPER, BudgetConfig, EvolutionConfig, JobConfig, PredictorConfig, SpaceConfig
from atoll.data.dataset import Dataset, Target
from atoll_coordinator.service.jobs.defaults import (
    RUNNERS_UP_NOISY,
    STAGNATION_CLEAN,
    STAGNATION_NOISY,
    resolve,
    stagnation_of,
)


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
    found = [stagnation_of(JobConfig(), target) for target in dataset(noise=0.01).targets]
    assert found == [STAGNATION_CLEAN, STAGNATION_NOISY]
    assert STAGNATION_NOISY < STAGNATION_CLEAN


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
    assert [stagnation_of(config, target) for target in dataset(noise=0.1).targets] == [7, 7]
    assert resolve(PAPER, dataset(9, noise=0.1)) == PAPER
    assert stagnation_of(PAPER, dataset(noise=0.1).targets[1]) == 500
