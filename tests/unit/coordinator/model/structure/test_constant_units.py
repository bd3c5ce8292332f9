"""Units of the constants of an equation, from those of the columns."""

from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.structure.constant_units import equation_units
from atoll_coordinator.tasks.defaults import with_units
from atoll_core.config import Angle, DataConfig, JobConfig
from atoll_core.data.dataset import Dataset, Target
from atoll_core.errors import DataError, UsageError
from atoll_core.expression.text.parsing import from_infix
from tests.unit.coordinator.data.tables import oscillator, table_of


def units(text, lhs="dx/dt", symbols=("x", "v"), **data):
    rows = np.ones((len(symbols), 4))
    dataset = Dataset(symbols, rows, (Target("x", lhs, rows[0], 0.0, 1.0),), {name: name for name in symbols})
    return equation_units(dataset, JobConfig(data=DataConfig(**data)), "x", from_infix(text, symbols))


def test_the_left_hand_side_is_a_rate():
    units_found = units("2*x - 3*v", units={"x": "m", "v": "m/s", "t": "s"})
    assert list(map(str, units_found.constants)) == ["1/s", "1"]


def test_velocities_follow_from_positions_and_time():
    units_found = units("2*x - 3*x_dot", "d2x/dt2", ("x", "x_dot"), order=2, units={"x": "m", "t": "s"})
    assert list(map(str, units_found.constants)) == ["1/s^2", "1/s"]


def test_angles_are_in_radians():
    units_found = units("2*sin(x)", units={"x": "deg", "t": "s"}, angles=(Angle(column="x", degrees=True),))
    assert (list(map(str, units_found.constants)), units_found.faults) == (["1/s"], ())


def test_a_header_may_hold_what_is_no_unit():
    assert units("2*x", units={"x": "??", "t": "s"}).constants == (None,)
    assert units("2*x") is None


def test_units_of_the_header_and_of_the_options_come_together():
    table = replace(table_of(oscillator()), units=("s", "m", ""))
    config = JobConfig(data=DataConfig(units={"y": "m/s", "x [m]": "km"}))
    source = prepare(table, config).source
    assert with_units(config, source).data.units == {"t": "s", "x": "km", "y": "m/s"}
    assert with_units(config, None) == config


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [({"z": "m"}, DataError, "no column 'z'"), ({"x": "m/"}, UsageError, "--unit for 'x'.*is no unit")],
)
def test_units_that_cannot_be_used_are_refused(given, error, words):
    with pytest.raises(error, match=words):
        prepare(table_of(oscillator()), JobConfig(data=DataConfig(units=given)))
