"""Hidden states by number: systems of two states, of which one is measured."""

import subprocess
import sys

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.batches import Spread, spreading
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.hidden.alternation import with_proposed_states
from atoll_coordinator.model.hidden.coordinates import propose_courses, scale_hidden_states
from atoll_coordinator.model.pipeline import refine_all
from atoll_coordinator.model.pools import Pool
from atoll_coordinator.tasks.defaults import resolve
from atoll_core.config import DataConfig, JobConfig
from atoll_core.data.table import Table
from atoll_core.errors import UsageError
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from tests.batches import ScatteredBatches
from tests.unit.coordinator.model.shooting.made import Known

OSCILLATOR = Known(("x", "v"), lambda _, s: (s[1], -4.0 * s[0] - 0.3 * s[1]))
PREY = Known(("x", "y"), lambda _, s: (s[0] - 0.5 * s[0] * s[1], 0.3 * s[0] * s[1] - 0.8 * s[1]))
BY_NUMBER = JobConfig(data=DataConfig(hidden=("1",)))


def table_of(system, start, times, *, noise=0.0, name="x"):
    """Return a table with the first state of a system."""
    values = system.values(start, times)[0]
    values = values + noise * values.std() * np.random.default_rng(1).standard_normal(len(times))
    rows = np.arange(len(times))
    return Table(("t", name), ("", ""), np.array([times, values]), (0,), ("made.csv",), np.zeros_like(rows), rows + 2)


def found(table, spread=None):
    """Return the preparation with a hidden course, the resolved configuration, and the laws."""
    preparation = prepare(table, BY_NUMBER)
    config = resolve(BY_NUMBER, preparation.dataset)
    return *with_proposed_states(preparation, config, spread or Spread()), config


def forecast(preparation, laws, times):
    """Return the measured state at `times` by the laws, from the last row on."""
    (part,) = preparation.recording.trajectories
    programs = [laws[0][name][0].program for name in preparation.dataset.variables]
    start = part.smoothed[:, -1]
    end = part.times[-1]

    def rates(_, state):
        return [float(values_of(program, np.array(state)[:, None])[0]) for program in programs]

    return solve_ivp(rates, (end, end + times[-1]), start, t_eval=end + times, rtol=1e-9, atol=1e-11).y[0]


@pytest.mark.parametrize(("noise", "accuracy"), [(0.0, 1e-6), (0.01, 0.02)])
def test_the_position_of_an_oscillator_determines_its_law(noise, accuracy):
    """Trace and determinant of a linear law do not depend on the coordinates of the hidden state."""
    _, laws, _ = found(table_of(OSCILLATOR, (1.0, 0.0), np.linspace(0.0, 12.0, 300), noise=noise))
    points = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    values = np.array([values_of(laws[0][name][0].program, points) for name in ("x", "h")])
    matrix = values[:, 1:] - values[:, :1]
    assert np.trace(matrix) == pytest.approx(-0.3, abs=accuracy)
    assert np.linalg.det(matrix) == pytest.approx(4.0, rel=accuracy)


def test_a_coefficient_of_each_hidden_state_is_one_and_nothing_else_changes():
    names, rng = ("x", "h1", "h2"), np.random.default_rng(0)
    texts = ("2*h1 - 0.3*x", "0.5*h1 + 3*h2*x - 4", "h1*h2 - x + 0.1*h2*h2")
    programs = {name: from_infix(text, names) for name, text in zip(names, texts, strict=True)}
    scaled, factors = scale_hidden_states(programs, {"h1": 1, "h2": 2})
    assert factors == {"h1": 2.0, "h2": 6.0}  # h2 occurs only with x in the equation of h1, which was scaled by 2
    points, by = rng.standard_normal((3, 5)), np.array([[1.0], [2.0], [6.0]])
    for name, factor in (("x", 1.0), *factors.items()):
        assert values_of(scaled[name], by * points) == pytest.approx(factor * values_of(programs[name], points))
    assert to_infix(scaled["x"], names) == to_infix(from_infix("1.0*h1 - 0.3*x", names, merges_constants=False), names)


def test_a_product_of_two_hidden_states_fixes_no_scale_and_a_sum_that_cancels_stays():
    names = ("x", "h1", "h2")
    texts = ("4*h1*h2", "2*x - h1", "x - x")
    programs = {name: from_infix(text, names) for name, text in zip(names, texts, strict=True)}
    scaled, factors = scale_hidden_states(programs, {"h1": 1, "h2": 2})
    assert factors == {"h1": 1.0, "h2": 1.0}
    points = np.random.default_rng(0).standard_normal((3, 5))
    for name in names:
        assert values_of(scaled[name], points) == pytest.approx(values_of(programs[name], points))
    _, factors = scale_hidden_states(programs | {"x": from_infix("3*h1*x", names)}, {"h1": 1, "h2": 2})
    assert factors == {"h1": 3.0, "h2": 1.0}
    _, factors = scale_hidden_states(programs | {"x": from_infix("300*h1*x", names)}, {"h1": 1, "h2": 2})
    assert factors == {"h1": 1.0, "h2": 1.0}  # values far from one


def test_the_scale_of_a_hidden_state_leaves_no_constant_that_the_data_do_not_determine():
    system = Known(("x", "v"), lambda _, s: (s[1], 1.2 * (1.0 - s[0] ** 2) * s[1] - s[0]))
    preparation, laws, config = found(table_of(system, (0.5, 0.0), np.linspace(0.0, 15.0, 300)))
    pools = {name: Pool(()) for name in ("x", "h")}
    refinement = refine_all(preparation, config, pools, laws=laws)
    assert to_infix(refinement.equations["x"].program, ("x", "h")) == "h"
    for equation in refinement.equations.values():
        assert all(constant.identifiable for constant in equation.constants)
        assert equation.grade == "good"


def test_prey_alone_determines_the_cycle_of_prey_and_predator():
    times = np.linspace(0.0, 34.0, 544)
    given = 400
    preparation, laws, _ = found(table_of(PREY, (2.0, 1.0), times[:given], noise=0.01))
    truth = PREY.values((2.0, 1.0), times)[0, given:]
    predicted = forecast(preparation, laws, times[given:] - times[given - 1])
    assert ((predicted - truth) ** 2).mean() < 0.01 * truth.var()


def test_the_course_is_a_column_of_the_search_and_of_the_recording():
    preparation, _, _ = found(table_of(OSCILLATOR, (1.0, 0.0), np.linspace(0.0, 12.0, 300)))
    (part,) = preparation.recording.trajectories
    assert preparation.recording.hidden == ("h",)
    assert np.isnan(part.measured[1]).all()
    assert abs(np.corrcoef(part.smoothed[1], OSCILLATOR.values((1.0, 0.0), part.times - part.times[0])[1])[0, 1]) > 0.99
    assert preparation.dataset.names == ("x", "h")
    assert np.isin(preparation.dataset.inputs[1], part.smoothed[1]).all()
    assert [target.variable for target in preparation.dataset.targets] == ["x", "h"]


def test_proposals_have_mean_0_and_standard_deviation_1():
    preparation = prepare(table_of(PREY, (2.0, 1.0), np.linspace(0.0, 25.0, 400)), BY_NUMBER)
    courses = propose_courses(preparation.recording, 1)
    assert {"rate of x", "relative rate of x", "observer form of a linear law"} <= {one.coordinates for one in courses}
    for course in courses:
        assert course.values[0].mean() == pytest.approx(0.0, abs=1e-12)
        assert course.values[0].std() == pytest.approx(1.0)


def test_threads_and_workers_give_the_same_bits():
    table = table_of(PREY, (2.0, 1.0), np.linspace(0.0, 20.0, 200), noise=0.02)
    answers = []
    for batches in (None, ScatteredBatches(3)):
        with spreading(batches, 1, Deadline()) as spread:
            preparation, laws, _ = found(table, spread)
        (part,) = preparation.recording.trajectories
        programs = [law.program.to_bytes() for (law,) in laws[0].values()]
        answers.append((programs, part.smoothed.tobytes(), part.slopes.tobytes()))
    assert answers[0] == answers[1]


def test_an_equation_with_a_hidden_state_is_never_exact():
    preparation, laws, config = found(table_of(OSCILLATOR, (1.0, 0.0), np.linspace(0.0, 12.0, 300)))
    refined = refine_all(preparation, config, {name: Pool(()) for name in ("x", "h")}, laws=laws)
    assert set(refined.equations) == {"x", "h"}
    assert all(one.grade in ("good", "doubtful") for one in refined.equations.values())
    for one in refined.equations.values():
        (constants,) = (check for check in one.checks if check.name == "constants")
        assert (constants.outcome == "not applicable") == (not one.constants)
    assert any("No column measures h" in warning and "change of coordinates" in warning for warning in refined.warnings)


def test_a_hidden_state_has_a_name_that_no_column_has():
    table = table_of(OSCILLATOR, (1.0, 0.0), np.linspace(0.0, 6.0, 100), name="h")
    assert prepare(table, BY_NUMBER).recording.hidden == ("hidden",)
    two = BY_NUMBER.model_copy(update={"data": DataConfig(hidden=("2",))})
    table = table_of(OSCILLATOR, (1.0, 0.0), np.linspace(0.0, 6.0, 100))
    assert prepare(table, two).recording.hidden == ("h1", "h2")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"hidden": ("0",)}, "the number 0"),
        ({"hidden": ("1",), "target": "x"}, "hidden and target exclude"),
        ({"hidden": ("1",), "stochastic": True}, "hidden and stochastic exclude"),
        ({"hidden": ("1",), "order": 2}, "hidden and order=2 exclude"),
        ({"hidden": ("1",), "per_trajectory": True}, "hidden and per_trajectory exclude"),
        ({"hidden": ("1",), "offsets": ("x",)}, "hidden and offsets exclude"),
        ({"hidden": ("1",), "only": ("x",)}, "hidden and only exclude"),
    ],
)
def test_what_makes_no_sense_with_a_hidden_state_is_refused(data, message):
    table = table_of(OSCILLATOR, (1.0, 0.0), np.linspace(0.0, 6.0, 100))
    with pytest.raises(UsageError, match=message):
        prepare(table, JobConfig(data=DataConfig(**data)))


def test_a_worker_that_has_only_helped_knows_the_functions_of_hidden_states():
    """A helper has not prepared the job itself, so nothing else has loaded the modules."""
    program = (
        "import importlib; from atoll.tasks.process import _MODULES as modules\n"
        "from atoll_coordinator.model.batches import FUNCTIONS\n"
        "for name in ('hidden courses', 'trajectory starts'):\n"
        "    importlib.import_module(modules[name]); assert name in FUNCTIONS\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
