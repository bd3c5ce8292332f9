"""What is handed from one task of a job to the next comes back to the bit from the bytes in which it travels."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.data.recording import Preparation, ProcessRecording, SampledPath
from atoll_coordinator.model.description_length import TrajectoryMisfit
from atoll_coordinator.model.pools import Law, LawsByGroup, Pools
from atoll_coordinator.model.shooting.error_model import ErrorModel
from atoll_coordinator.model.shooting.measurements import TrajectoryMeasurements
from atoll_coordinator.model.shooting.system import OdeSystem
from atoll_coordinator.service.jobs.job import Prepared
from atoll_core.config import DataConfig, JobConfig, PriorConfig, SpaceConfig
from atoll_core.expression.restrictions import Restrictions, restrictions_of
from atoll_core.wire.values import decode_value, encode_value
from tests.unit.coordinator.model.shooting.made import LOTKA, LOTKA_TEXT, compare, measurements, pools, table
from tests.values import is_same

TIMES = 0.1 * np.arange(40.0)
STARTS = ([1.0, 3.0], [4.0, 1.0], [8.0, 2.0])
CONFIG = JobConfig(
    data=DataConfig(units={"x": "g/m^2", "t": "day"}),
    prior=PriorConfig(bounds={"x": ("x*y < 0", "c < 10")}),
    space=SpaceConfig(operators=("-", "*"), required_of={"x": ("x",)}),
)
POOL = {"x": ("x", "2.5*x - 1.5*x*y - 0.8*x*x"), "y": ("y", "1.5*y - 0.5*x*y - 0.8*y*y")}


@pytest.fixture(scope="module")
def preparation() -> Preparation:
    return prepare(table(LOTKA, STARTS, TIMES, 0.02), CONFIG)


def is_back(value: Any, kind: Any = None) -> bool:
    data = encode_value(value, kind)
    back = decode_value(data, type(value) if kind is None else kind)
    return is_same(back, value) and encode_value(back, kind) == data


def test_preparations_and_pools(preparation: Preparation) -> None:
    made, laws = pools(preparation, **POOL), [{"x": (Law(LOTKA.parsed(LOTKA_TEXT[0]), -math.inf, math.nan, True),)}, {}]
    assert is_back(preparation)
    assert is_back(made, Pools)
    assert is_back(laws, LawsByGroup)
    known = {"x": made["x"].front[0]}
    assert is_back(Prepared(preparation, CONFIG, "ab", 3, known, frozenset({"y"}), laws))
    path = SampledPath("a", TIMES, np.ones((1, 40)), np.ones((0, 40)))
    process = ProcessRecording(("x",), ("x",), (), (), 0.5, (path,), np.array([0.1]), ((0, 0),))
    assert is_back(replace(preparation, recording=None, process=process))


def test_what_comparisons_are_made_of() -> None:
    seen = measurements(LOTKA, STARTS, TIMES, noise=0.05)
    comparison = compare(LOTKA, seen)
    model = comparison.fit_model([LOTKA.parsed(text) for text in LOTKA_TEXT], lengths=(8, None))
    assert model is not None
    assert is_back(seen, TrajectoryMeasurements)
    assert is_back(model.fit.system, OdeSystem)
    assert is_back(replace(model.fit.errors, sigmas=np.array([math.inf, math.nan])), ErrorModel)
    assert is_back(comparison.score.misfit, TrajectoryMisfit)
    constants = np.stack([model.fit.system.constants, 2.0 * model.fit.system.constants])
    first, other = comparison.places(model.fit.system)[:2]
    assert is_back(model.fit.system.sharing_numbers(constants, [((first, 1.0), (other, 2.0))]))
    assert is_back(restrictions_of(CONFIG, "x", LOTKA.names), Restrictions)
