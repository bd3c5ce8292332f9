"""What a configuration leaves open is filled in from the data."""

import numpy as np

from common.config import PAPER, JobConfig, PredictorConfig, SpaceConfig
from common.dataset import Dataset, Target
from coordinator.service.resolve import resolve


def dataset(variables: int = 2, floor: float = 1e-9, noise: float = 0.0) -> Dataset:
    names = tuple(f"x{index}" for index in range(variables))
    values = np.linspace(0.0, 1.0, 10)
    clean = Target(names[0], "dx0/dt", values, 1e-9, 1.0)
    other = Target(names[-1], "dx/dt", values, floor, 1.0, noise)
    return Dataset(names, np.stack([values] * variables), (clean, other), {name: name for name in names})


def test_clean_data_need_16_rows_and_noisy_ones_64() -> None:
    assert resolve(JobConfig(), dataset()).predictors.rows == 16
    assert resolve(JobConfig(), dataset(floor=0.01)).predictors.rows == 64
    assert resolve(JobConfig(), dataset(noise=0.01)).predictors.rows == 64


def test_terminals_grow_with_the_variables() -> None:
    assert [resolve(JobConfig(), dataset(count)).space.terminals for count in (1, 2, 3, 9)] == [7, 7, 8, 14]


def test_what_is_given_stands() -> None:
    config = JobConfig(predictors=PredictorConfig(rows=20), space=SpaceConfig(terminals=9))
    assert resolve(config, dataset(noise=0.1)) == config
    assert resolve(PAPER, dataset(9, noise=0.1)) == PAPER
