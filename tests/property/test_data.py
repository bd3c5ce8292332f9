"""Whatever a file holds and whatever the options say: a sound dataset comes out, or one sentence."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from atoll_coordinator.data.outline import describe
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.data.reading.files import read_table
from atoll_core.config import Angle, DataConfig, JobConfig
from atoll_core.errors import AtollError, DataError
from tests.unit.coordinator.data.tables import table_of

NAMES = ("t", "x", "y", "trajectory", "lambda")
names = st.sampled_from((*NAMES, "nowhere"))
some = st.lists(names, max_size=2).map(tuple)
sensible = st.builds(
    lambda options, missing, robust: DataConfig(**options, missing=missing, robust=robust),
    st.sampled_from(
        (
            {"states": ("x",)},
            {"states": ("x",), "inputs": ("t", "y")},
            {"states": ("x",), "order": 2},
            {"states": ("x", "y"), "trajectory": "trajectory", "order": 2},
            {"states": ("x", "y"), "inputs": ("lambda",), "trajectory": "trajectory", "holdout": 1},
            {"states": ("x",), "trajectory": "trajectory", "holdout": "trajectory=1"},
            {"target": "x"},
            {"states": ("x",), "derivatives": ("y",)},
            {"states": ("x",), "angles": (Angle(column="x", degrees=True),)},
        )
    ),
    st.sampled_from(("drop", "drop", "refuse")),
    st.booleans(),
)
wild = st.builds(
    DataConfig,
    time=st.none() | names,
    states=st.none() | some,
    inputs=some,
    trajectory=st.none() | names,
    target=st.none() | names,
    derivatives=st.none() | some,
    order=st.sampled_from((1, 1, 2)),
    angles=st.just(()) | st.builds(Angle, column=names, degrees=st.booleans()).map(lambda angle: (angle,)),
    only=st.none() | some,
    missing=st.sampled_from(("refuse", "drop")),
    robust=st.booleans(),
    holdout=st.sampled_from((None, None, 1, 2, "trajectory=2", "x=1")),
)


@st.composite
def tables(draw):
    """Draw tables from the tame to the wild: smooth, noisy, constant, enormous, with gaps."""
    rows = draw(st.integers(1, 40))
    rng = np.random.default_rng(draw(st.integers(0, 99)))
    gaps = np.where(rng.uniform(size=rows) < 0.1, 60.0, 1.0)
    steps = draw(st.sampled_from((np.ones(rows), rng.uniform(0.1, 3.0, rows), gaps)))
    columns = {"t": np.cumsum(steps) * draw(st.sampled_from((0.1, 1e-9, 1e9)))}
    for name in ("x", "y", "lambda"):
        kinds = (
            np.sin(columns["t"]),
            rng.normal(size=rows),
            np.zeros(rows),
            np.floor(np.arange(rows) / 7),
            columns["t"],
        )
        with np.errstate(all="ignore"):
            columns[name] = draw(st.sampled_from(kinds)) * draw(st.sampled_from((1.0, 1e-300, 1e300, 1e160, -1e-5)))
    columns["trajectory"] = np.repeat([1.0, 2.0], [rows // 2, rows - rows // 2])
    if draw(st.booleans()):
        columns["x"] = np.where(rng.uniform(size=rows) < 0.1, np.nan, columns["x"])
    return table_of(columns, draw(st.sampled_from(((0,), (0, rows // 2) if rows > 1 else (0,)))))


def assert_one_sentence(error):
    assert str(error)
    assert "\n" not in str(error)


def assert_sound(recording):
    for trajectory in recording.trajectories:
        rows = len(trajectory.times)
        assert (np.diff(trajectory.times) > 0.0).all()
        assert trajectory.measured.shape == (len(recording.states), rows)
        assert not np.isinf(trajectory.measured).any()
        for array in (trajectory.smoothed, trajectory.slopes):
            assert array.shape == (len(recording.states), rows)
            assert np.isfinite(array).all()
        assert trajectory.inputs.shape == trajectory.input_slopes.shape == (len(recording.inputs), rows)
        assert np.isfinite(trajectory.inputs).all()


@pytest.mark.slow
@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(table=tables(), config=sensible | wild, preset=st.sampled_from(("default", "default", "paper")))
def test_tables_become_sound_datasets_or_one_sentence(table, config, preset):
    job = JobConfig(preset=preset, data=config)
    objection: AtollError | None = None
    try:
        described = describe(table, job)
        preparation = prepare(table, job)
    except AtollError as error:
        objection = error
    if objection is not None:
        assert objection.exit_code == 2
        assert_one_sentence(objection)
        return
    assert described
    dataset = preparation.dataset
    if preparation.held_out is not None:
        assert preparation.held_out.variables == dataset.variables
        assert np.isfinite(preparation.held_out.inputs).all()
    if preparation.recording is not None:
        assert_sound(preparation.recording)
    assert dataset.targets
    assert np.isfinite(dataset.inputs).all()
    assert len(set(dataset.names)) == len(dataset.names) == len(dataset.inputs)
    for target in dataset.targets:
        assert np.isfinite(target.values).all()
        assert target.values.shape == dataset.inputs.shape[1:]
        assert np.isfinite([target.uncertainty, target.standard_deviation, target.noise]).all()
        assert target.standard_deviation > 0.0
        assert target.uncertainty >= 0.0


cells = st.text(alphabet="0123456789.,;-+einf\t\r\n \"'[]tx#NaN%:/m\u00a0\ufeff", max_size=60)


@pytest.mark.slow
@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=cells.map(str.encode) | cells.map(lambda text: ("t,x\n" + text).encode()) | st.binary(max_size=40))
def test_any_file_becomes_a_table_or_one_sentence(tmp_path, data):
    path = tmp_path / "any.csv"
    path.write_bytes(data)
    objection: DataError | None = None
    try:
        table = read_table([path], DataConfig())
    except DataError as error:
        objection = error
    if objection is not None:
        assert_one_sentence(objection)
        return
    assert table.rows >= 1
    assert len(table.names) == len(set(table.names)) == len(table.columns)
