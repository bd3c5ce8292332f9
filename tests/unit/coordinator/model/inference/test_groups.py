"""From a table with groups of trajectories to one structure with constants of each."""

from dataclasses import replace

import numpy as np
import pytest

from atoll.api.model import Model
from atoll.api.tables import table_of
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.data.reading.files import read_table
from atoll_coordinator.data.roles.roles import assign_roles
from atoll_coordinator.data.trajectories.measurements import take_measurements
from atoll_coordinator.model.pipeline import refine_all
from atoll_coordinator.model.refinement import Refinement
from atoll_coordinator.model.result.building import KNOWN, NOT_BY_GROUP, Account, VariableOutcome, build_result
from atoll_coordinator.model.selection import joint_search
from atoll_core.config import DataConfig, JobConfig, PriorConfig, SpaceConfig
from atoll_core.data.table import Table
from atoll_core.errors import DataError, UsageError
from atoll_core.expression.evaluation import values_of
from atoll_core.search.pareto import FrontEntry
from tests.unit.coordinator.model.fitting import settings
from tests.unit.coordinator.model.result.plain import render_text
from tests.unit.coordinator.model.shooting.made import pools

RATES, CAPACITY = (0.5, 1.0, 1.7), 2.0
TIMES = 0.2 * np.arange(40.0)


@pytest.fixture(autouse=True)
def _little_work(monkeypatch):
    monkeypatch.setattr(joint_search, "SETTINGS", settings("effort", work=1_000_000))


def table(noise=0.02, rates=RATES):
    """Return runs of logistic growth, each with a rate of its own."""
    draw = np.random.default_rng(4)
    values = [CAPACITY / (1.0 + 19.0 * np.exp(-rate * TIMES)) for rate in rates]
    runs = np.repeat(np.arange(float(len(rates))) + 1.0, len(TIMES))
    x = np.concatenate(values) + noise * draw.standard_normal(len(runs))
    rows = np.arange(len(runs), dtype=np.int64)
    columns = np.array([runs, np.tile(TIMES, len(rates)), x])
    return Table(("strain", "t", "x"), ("", "", ""), columns, (0,), ("a.csv",), 0 * rows, rows + 2, ())


def config(**data):
    return JobConfig(data=DataConfig(**data), space=SpaceConfig(operators=("-", "*")))


def refined(noise=0.02, **data):
    preparation = prepare(table(noise), config(**data))
    return preparation, refine_all(preparation, config(**data), pools(preparation, x=("x", "x*(2 - x)")))


def test_what_differs_is_told_and_what_does_not_is_shared():
    _, refinement = refined(group="strain")
    (equation,) = refinement.equations.values()
    assert [*equation.by_group] == ["1", "2", "3"]
    shared = [constant.shared for constant in equation.constants]
    assert sorted(shared) == [False, True]
    rate, capacity = shared.index(False), shared.index(True)
    points = np.array([[0.5, 1.0, 1.5]])
    for (program, constants), true in zip(equation.by_group.values(), RATES, strict=True):
        assert values_of(program, points) == pytest.approx(true * points[0] * (1.0 - points[0] / CAPACITY), rel=0.1)
        low, high = constants[rate].interval
        assert low < constants[rate].fitted < high
        assert constants[capacity] == equation.constants[capacity]
    assert equation.grade == "good"


def test_a_result_has_the_equation_of_each_group():
    preparation, refinement = refined(group="strain")
    outcome = VariableOutcome("x", (), 1)
    result = build_result(
        "j", config(group="strain"), preparation, [outcome], Account("done", 1.0, 1.0), refinement
    ).as_dict()
    (equation,) = result["equations"]
    assert [group["group"] for group in equation["groups"]] == ["1", "2", "3"]
    assert [group["trajectories"] for group in result["groups"]] == [["1"], ["2"], ["3"]]
    assert np.array(result["groups"][0]["covariance"]["matrix"]).shape == (2, 2)
    text = render_text(result)
    assert "    group  " in text
    assert "± " in text


def test_each_trajectory_may_be_a_group():
    data = table()
    preparation = prepare(data, config(trajectory="strain", per_trajectory=True))
    assert preparation.recording.groups == ("1", "2", "3")
    assert preparation.dataset.groups.max() == 2
    assert [trajectory.group for trajectory in preparation.recording.trajectories] == ["1", "2", "3"]


def two_states():
    """Return logistic growth of x by strain, and y that decays alike in all strains."""
    measured = table(rates=RATES[:2])
    decay = np.tile(2.0 * np.exp(-0.7 * TIMES), 2)
    decay += 0.02 * np.random.default_rng(5).standard_normal(len(decay))
    return replace(
        measured,
        names=(*measured.names, "y"),
        units=(*measured.units, ""),
        columns=np.array([*measured.columns, decay]),
    )


@pytest.mark.parametrize("data", [{"group": "strain"}, {"trajectory": "strain", "per_trajectory": True}])
def test_a_known_equation_alone_has_no_constants_by_group(data):
    config = JobConfig(data=DataConfig(**data), prior=PriorConfig(known={"x": "0.9*x*(1 - 0.5*x)"}))
    preparation = prepare(table(), config)
    refinement = refine_all(preparation, config, {})
    front = (FrontEntry(9, 0.1, 0.1, 0, 0, 0, refinement.equations["x"].program.to_bytes()),)
    outcome = VariableOutcome("x", front, 0, why=KNOWN)
    result = build_result("j", config, preparation, [outcome], Account("done", 1.0, 1.0), refinement).as_dict()
    model = Model(result)
    assert model.groups == ()
    assert model.simulate({"x": 0.1}, 5.0).status == "finished"
    assert NOT_BY_GROUP not in result["warnings"]


def test_a_known_equation_stands_beside_one_by_group():
    space = SpaceConfig(operators=("-", "*"), variables_of={"x": ("x",)})
    config = JobConfig(data=DataConfig(group="strain"), space=space, prior=PriorConfig(known={"y": "-0.7*y"}))
    preparation = prepare(two_states(), config)
    refinement = refine_all(preparation, config, pools(preparation, x=("x", "x*(2 - x)")))
    assert refinement.equations["y"].by_group == {}
    assert refinement.equations["y"].constants[0].shared is None
    assert [*refinement.equations["x"].by_group] == ["1", "2"]


def test_constants_that_no_group_differs_in_have_one_covariance():
    preparation = prepare(table(rates=(1.0, 1.0)), config(group="strain"))
    refinement = refine_all(preparation, config(group="strain"), pools(preparation, x=("x", "x*(2 - x)")))
    assert all(constant.shared for constant in refinement.equations["x"].constants)
    assert refinement.covariance is not None


def test_a_result_says_that_constants_were_not_fitted_by_group():
    preparation = prepare(table(), config(group="strain"))
    for state, count in (("running", 0), ("done", 1)):
        refinement = Refinement({}, warnings=("cut short",), end="max-time")
        outcome = VariableOutcome("x", (), 1)
        result = build_result(
            "j", config(group="strain"), preparation, [outcome], Account(state, 1.0, 1.0), refinement
        ).as_dict()
        assert result["warnings"].count(NOT_BY_GROUP) == count


@pytest.mark.parametrize(
    ("data", "error", "words"),
    [
        ({"group": "strain", "per_trajectory": True}, UsageError, "exclude each other"),
        ({"group": "strain", "target": "x"}, UsageError, "group and target exclude"),
        ({"group": "strain", "holdout": 1}, DataError, "takes all trajectories of group 3"),
        ({"group": "strian"}, DataError, "did you mean 'strain'"),
        ({"group": "strain", "stochastic": True}, UsageError, "stochastic and group"),
    ],
)
def test_groups_that_are_none_are_refused_in_one_sentence(data, error, words):
    with pytest.raises(error, match=words) as caught:
        prepare(table(), config(**data))
    assert "\n" not in str(caught.value)


def test_groups_may_have_names_in_files_and_in_frames(tmp_path):
    rows = [(name, 0.1 * k, 1.0 + 0.1 * k * rate) for name, rate in (("wild", 1.0), ("mutant", 2.0)) for k in range(20)]
    for file, part in (("a.csv", rows[:20]), ("b.csv", [*rows[20:], *rows[:20]])):
        (tmp_path / file).write_text("strain,t,x\n" + "".join(f"{n},{t!r},{x!r}\n" for n, t, x in part))
    read = read_table([tmp_path / "a.csv", tmp_path / "b.csv"], DataConfig(group="strain"))
    frame = {"strain": [n for n, *_ in rows], "t": [t for _, t, _ in rows], "x": [x for *_, x in rows]}
    for table in (read, table_of(frame, DataConfig(group="strain")), Table.from_bytes(read.to_bytes())):
        assert table.labels == {"strain": ("wild", "mutant")}
        groups = take_measurements(table, *assign_roles(table, DataConfig(group="strain"))).groups
        assert groups == ("wild", "mutant", "wild")[: len(groups)]
    (tmp_path / "c.csv").write_text("strain,t,x\n1,0.0,1.0\n1,0.1,1.1\n")
    with pytest.raises(DataError, match=r"holds numbers in c\.csv and text"):
        read_table([tmp_path / "a.csv", tmp_path / "c.csv"], DataConfig(group="strain"))


def test_a_group_may_have_one_trajectory_that_is_short():
    """Of ten rows there is one segment, and of those of longer trajectories every second one is integrated alone."""
    measured = table()
    kept = (measured.columns[0] < 3.0) | (measured.columns[1] < 2.0)
    rows = {name: getattr(measured, name)[kept] for name in ("file_of_row", "line_of_row")}
    preparation = prepare(replace(measured, columns=measured.columns[:, kept], **rows), config(group="strain"))
    refinement = refine_all(preparation, config(group="strain"), pools(preparation, x=("x", "x*(2 - x)")))
    assert [*refinement.equations["x"].by_group] == ["1", "2", "3"]
