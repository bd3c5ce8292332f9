"""From pools to the refinement that a job shows: chosen, fitted, rounded, assessed and judged by trajectories."""

import itertools
import math
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from types import SimpleNamespace

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.batches import Batches
from atoll_coordinator.model.constants.rounding import FittedEquations
from atoll_coordinator.model.constants.standard_errors import describe_constants
from atoll_coordinator.model.deadline import CHOICE_SHARE, Deadline
from atoll_coordinator.model.description_length import system_length
from atoll_coordinator.model.inference import conclusion, final_model, trajectory_checks
from atoll_coordinator.model.inference.conclusion import _odds_without_prices
from atoll_coordinator.model.inference.final_model import _show_equations, estimate_errors
from atoll_coordinator.model.inference.trajectory_checks import drop_larger_equations, share_of_rate, standard_deviation
from atoll_coordinator.model.pipeline import NOT_SIMULATED, refine_all
from atoll_coordinator.model.pools import Pool
from atoll_coordinator.model.refinement import Alternative, Refinement
from atoll_coordinator.model.selection import joint_search, piece_lengths
from atoll_coordinator.model.selection.candidates import collect_candidates, form_key
from atoll_coordinator.model.selection.score import FittedModel, Score
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import DataConfig, JobConfig, PriorConfig, SpaceConfig
from atoll_core.data.dataset import Dataset, Target
from atoll_core.expression.operators import BY_NAME
from atoll_core.expression.program import constant_places
from atoll_core.expression.text.parsing import from_infix
from atoll_core.search.pareto import FrontEntry
from tests.batches import ScatteredBatches
from tests.unit.coordinator.model.fitting import settings
from tests.unit.coordinator.model.inference.refining import (
    ARITHMETIC,
    LOTKA_POOL,
    LOTKA_STARTS,
    NO_LIBRARIES,
    TIMES,
    check_of,
    is_near,
    is_same,
    refined,
)
from tests.unit.coordinator.model.shooting.made import (
    DECAY,
    DRIVEN,
    LOTKA,
    SWING,
    Known,
    compare,
    measurements,
    pools,
    table,
)
from tests.values import is_same as is_same_to_the_bit


@pytest.fixture(autouse=True)
def _little_work(monkeypatch):
    """Few neighbours are looked at, so that a test takes a second or two."""
    monkeypatch.setattr(joint_search, "SETTINGS", settings("effort", work=2_000_000))


@pytest.mark.parametrize(("rows", "grade"), [(6, "doubtful"), (60, "good")])
def test_a_constant_rate_of_few_rows_is_no_more_than_a_walk_with_a_drift(rows, grade):
    """Few rows of any smooth curve are about a line, that of a growth in its middle for instance."""
    line = Known(("h",), lambda _, z: [0.5 + 0.0 * z[0]])
    refinement = refined(line, ([1.0],), {"h": ("0.5", "0.6")}, times=6.0 / rows * np.arange(rows), noise=0.03, seed=3)
    assert refinement.equations["h"].grade == grade
    assert check_of(refinement, "h", "no equation").outcome == ("passed" if grade == "good" else "failed")


@pytest.mark.parametrize("rows", [7, 60])
def test_what_follows_from_an_equation_that_is_no_better_than_none_was_not_tested(rows):
    """x follows from y, and seven rows of y are a walk with a drift as well as a law."""
    falling = Known(("x", "y"), lambda _, z: [z[1], 0.5 + 0.0 * z[0]])
    refinement = refined(falling, ([1.0, -2.0],), {"x": ("y",), "y": ("0.5",)}, times=8.0 / rows * np.arange(rows),
                         noise=0.02, seed=3)  # fmt: skip
    made, is_baseless = check_of(refinement, "x", "other initial states"), rows == 7
    assert ((made.outcome, "they follow from 'y'" in made.reason) == ("not made", True)) == is_baseless
    assert check_of(refinement, "y", "no equation").outcome == ("failed" if is_baseless else "passed")
    assert "follow from" not in check_of(refinement, "y", "other initial states").reason
    assert (refinement.equations["x"].prediction is None) == is_baseless


def test_the_odds_of_the_data_have_no_price_of_structures():
    """An equation with a sine that fits as well with as many constants is as likely; an elaboration is not."""
    points = np.linspace(0.2, 2.0, 30)[None]

    def model(text, misfit):
        program = from_infix(text, ("x",))
        nats = system_length(misfit, [program], len(constant_places(program)), constant_nats=2.0)
        return FittedModel((program,), None, misfit, nats)

    own = model("-0.8*x", 7.0)
    others = [model("-0.8*sin(x)*cos(x)", 7.0), model("-0.8*sin(x)*cos(x)", 9.0), model("0.1*x*x - 0.8*sin(x)", 6.0)]
    odds = [_odds_without_prices(other, own, 0, points) for other in others]
    assert odds == pytest.approx([1.0, math.exp(-2.0), math.exp(-1.0)])
    longer = model("0.1 - 0.8*x", 6.0)
    assert _odds_without_prices(longer, own, 0, points) == pytest.approx(math.exp(own.nats - longer.nats))


def test_a_given_equation_is_compared_with_a_walk_step_by_step():
    config = JobConfig(space=NO_LIBRARIES, prior=PriorConfig(known={"x": "-0.5*x"}))
    times = 0.3 * np.arange(12.0)
    refinement = refined(DECAY, ([1.0], [2.0]), {"x": ("x",)}, times=times, noise=0.05, seed=3, config=config)
    rows = [(part.measured["x"], part.values["x"]) for part in refinement.simulation.trajectories]
    squares = sum(np.square(np.subtract(measured, values)).sum() for measured, values in rows)
    steps = np.concatenate([np.diff(measured) for measured, _ in rows])
    nats = 0.5 * len(steps) * math.log(float(steps @ steps) / squares)
    assert check_of(refinement, "x", "no equation").value == pytest.approx(nats, rel=1e-3)


def test_an_exact_line_of_five_rows_is_not_exact():
    line = Known(("h",), lambda _, z: [40.0 + 0.0 * z[0]])
    refinement = refined(line, ([30.0],), {"h": ("40.0",)}, times=0.5 * np.arange(5.0))
    assert refinement.equations["h"].grade == "doubtful"


def test_rows_at_rest_are_no_rows_to_test_an_equation_by():
    """x decays to 0.1 within three rows and stays: three values, whatever y does meanwhile."""
    falling = Known(("x", "y"), lambda _, z: [-3.0 * (z[0] - 0.1), -0.2 * z[1]])
    config = JobConfig(space=SpaceConfig(operators=("-", "*"), variables_of={"x": ("x",), "y": ("y",)}))
    made = table(falling, ([4.7, 2.5],), np.arange(10.0))
    rounded = replace(made, columns=np.where(np.arange(3)[:, None] == 1, np.round(made.columns, 1), made.columns))
    preparation = prepare(rounded, config)
    pool = pools(preparation, x=("0.3 - 3.0*x", "0.3 - 2.9*x - 0.01*x*x*x"), y=("-0.2*y",))
    refinement = refine_all(preparation, config, pool)
    assert check_of(refinement, "x", "distinct rows").value == 3
    assert check_of(refinement, "y", "distinct rows").value == 10
    assert refinement.equations["x"].grade == "doubtful"


@pytest.mark.parametrize(("text", "rows"), [("u - x", 2), ("u - x*y", 10), ("0.5*u", 2)])
def test_distinct_rows_are_counted_in_the_variables_of_the_equation(text, rows):
    """x and the input u rest after one row, and y goes on."""
    resting, names = np.minimum(np.arange(10.0), 1.0), ("x", "y", "u")
    measurements = SimpleNamespace(
        smoothed=np.zeros((2, 10)), variables=names, observed=np.arange(2), inputs=resting[None],
        measured=np.array([resting, np.arange(10.0)]),
    )  # fmt: skip
    checks = object.__new__(trajectory_checks.TrajectoryChecks)
    recording = SimpleNamespace(observed=())
    final = SimpleNamespace(task=SimpleNamespace(dataset=SimpleNamespace(names=names), recording=recording))
    shown = SimpleNamespace(program=from_infix(text, names))
    vars(checks).update(measurements=measurements, final=final, index=0, column=0, shown=shown)
    assert checks._count_distinct_rows() == rows


@pytest.fixture(scope="module")
def noisy():
    """Five percent of noise; one trajectory is held out."""
    with pytest.MonkeyPatch.context() as patch, np.errstate(all="raise", under="ignore"):
        patch.setattr(joint_search, "SETTINGS", settings("effort", work=2_000_000))
        config = JobConfig(space=ARITHMETIC, data=DataConfig(holdout=1))
        return refined(LOTKA, LOTKA_STARTS, LOTKA_POOL, noise=0.05, seed=101, config=config)


def test_noisy_equations_come_out_in_form_with_estimates(noisy):
    assert is_near(LOTKA, noisy, x="3*x - 2*x*y - x**2", y="2*y - x*y - y**2")


@pytest.fixture(scope="module")
def processes():
    with ProcessPoolExecutor(2, get_context("spawn")) as executor:
        yield executor


def scattered(batches: Batches | None = None) -> Refinement:
    times = 0.1 * np.arange(30.0)
    return refined(LOTKA, LOTKA_STARTS, LOTKA_POOL, noise=0.02, times=times, batches=batches)


@pytest.fixture(scope="module")
def computed_here() -> Refinement:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(joint_search, "SETTINGS", settings("effort", work=2_000_000))
        return scattered()


@pytest.mark.parametrize("workers", [2, *(pytest.param(count, marks=pytest.mark.slow) for count in (1, 3, 7))])
def test_wherever_and_in_which_order_batches_are_computed_changes_no_bit(workers, computed_here, processes):
    """By other processes, and by threads of this one; out of order, and some twice."""
    batches = ScatteredBatches(workers, processes if workers == 2 else None)
    assert is_same_to_the_bit(scattered(batches), computed_here)
    functions = {function for function, _ in batches.calls}
    assert {"fits", "folds", "sums of products", "writings"} <= functions


def test_the_threads_of_a_refinement_have_ended_with_it(monkeypatch):
    executors = []
    begin = ThreadPoolExecutor.__init__

    def recorded(self, *args, **options):
        begin(self, *args, **options)
        executors.append(self)

    monkeypatch.setattr(ThreadPoolExecutor, "__init__", recorded)
    assert refined(DECAY, [[1.0], [2.0]], {"x": ("x",)}, config=JobConfig(space=NO_LIBRARIES)).equations
    assert executors
    for executor in executors:
        with pytest.raises(RuntimeError, match="shutdown"):
            executor.submit(int)


def test_their_verdict_is_good(noisy):
    for equation in noisy.equations.values():
        assert equation.grade == "good"
        assert "agree with the noise" in equation.reason


def test_the_deviation_is_that_of_what_was_measured_and_counts():
    rows = measurements(DECAY, [[2.0]], TIMES, noise=0.3)
    rows.weights[0, :5] = 0.0
    rows.measured[0, :5] = np.nan
    assert standard_deviation(rows, 0) == pytest.approx(rows.measured[0, 5:].std())
    assert standard_deviation(rows, 0) != pytest.approx(float(rows.scales[0]))


def test_an_elaboration_of_the_equation_is_no_rival():
    programs = [DECAY.parsed(text) for text in ("-0.5*x", "-0.5*x + 0.1", "-0.4*sin(x)", "-0.5*x")]
    shown, *others = (Alternative(program, 1.0, 0.9, is_shown=not rank) for rank, program in enumerate(programs))
    assert drop_larger_equations(1, [shown, *others]) == others[1:]


def test_fitted_constants_have_intervals_around_them(noisy):
    for equation in noisy.equations.values():
        assert len(equation.constants) == len(constant_places(equation.program))
        for constant in equation.constants:
            low, high = constant.interval
            assert low < constant.value < high
            assert low < constant.fitted < high
            assert constant.identifiable


def test_the_equation_shown_is_the_first_contender_and_the_others_are_longer(noisy):
    for equation in noisy.equations.values():
        first, *others = equation.alternatives
        assert (first.program, first.nats, first.is_shown) == (equation.program, 0.0, True)
        assert others
        assert [other.nats for other in others] == sorted(other.nats for other in others)
        assert not any(other.is_shown for other in others)
        assert all(alternative.r2 <= 1.0 for alternative in equation.alternatives)


def test_held_out_trajectories_are_simulated_and_judged(noisy):
    assert [trajectory.held_out for trajectory in noisy.simulation.trajectories] == [False, False, False, True]
    assert all(r2 > 0.8 for trajectory in noisy.simulation.trajectories for r2 in trajectory.r2.values())
    assert all(
        alternative.is_cross_validated is False
        for equation in noisy.equations.values()
        for alternative in equation.alternatives
    )
    for name, equation in noisy.equations.items():
        assert equation.alternatives[0].held_out_r2 == noisy.simulation.trajectories[-1].r2[name]


def bands(trajectory):
    """Return values and half widths of the bands (O, R)."""
    values, upper = (np.array([*curves.values()]) for curves in (trajectory.values, trajectory.upper))
    return values, upper - values


def test_simulations_have_bands_that_hold_the_true_curve(noisy):
    for start, trajectory in zip(LOTKA_STARTS, noisy.simulation.trajectories, strict=True):
        values, widths = bands(trajectory)
        assert widths.shape == values.shape == (2, 40)
        assert (np.abs(values - LOTKA.values(start, TIMES)) <= 2.3 * widths).mean() > 0.95


def test_two_refinements_are_the_same_to_the_bit():
    def programs():
        pool = {"x": ("y",), "y": ("-x", "-1.9*x - 0.35*y")}
        config = JobConfig(space=NO_LIBRARIES)
        refinement = refined(SWING, ([1.0, 2.0], [0.5, -1.0], [2.0, 0.0]), pool, noise=0.03, seed=102, config=config)
        return [
            (equation.program, equation.constants, equation.alternatives) for equation in refinement.equations.values()
        ]

    assert programs() == programs()


def test_clean_equations_are_exact():
    pool = {"x": ("y",), "y": ("-x", "-1.9*x - 0.35*y")}
    refinement = refined(SWING, ([1.0, 2.0], [0.5, -1.0]), pool, config=JobConfig(space=NO_LIBRARIES))
    assert is_same(SWING, refinement, x="y", y="-2.0*x - 0.3*y")
    assert [equation.grade for equation in refinement.equations.values()] == ["exact", "exact"]
    assert refinement.warnings == ()
    shares = [r2 for trajectory in refinement.simulation.trajectories for r2 in trajectory.r2.values()]
    assert shares == pytest.approx([1.0] * 4, abs=1e-9)


def test_what_one_trajectory_cannot_tell_is_said():
    """Of two species that began alike x is y: which of them limits the growth shows where they are not."""
    alike = Known(("x", "y"), lambda _, z: [z[0] * (1.0 - z[0] - 0.5 * z[1]), z[1] * (1.0 - z[1] - 0.5 * z[0])])
    pool = {"x": ("x*(1.0 - 1.5*x)", "x*(1.0 - 1.5*y)"), "y": ("y*(1.0 - 1.5*y)", "y*(1.0 - 1.5*x)")}
    refinement = refined(
        alike, ([0.1, 0.1],), pool, times=0.1 * np.arange(100.0),
        config=JobConfig(space=NO_LIBRARIES, data=DataConfig(states=("x", "y"))),
    )  # fmt: skip
    for equation in refinement.equations.values():
        assert (equation.grade, equation.prediction.is_disputed) == ("doubtful", True)
        x, y = equation.prediction.measure_from.values()
        assert abs(x - y) > 0.05
        assert equation.reason.startswith("Another equation describes the data about as well (Δ description length 0")
        assert "easure from x = " in equation.reason


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_what_was_fitted_to_fewer_rows_is_simulated_along_all(monkeypatch, noise):
    """As constants of dozens of states are; here those of one trajectory of two."""
    monkeypatch.setattr(piece_lengths, "SETTINGS", settings("effort", work=50 * SETTINGS.effort.steps))
    config = JobConfig(space=NO_LIBRARIES)
    refinement = refined(DECAY, ([1.0], [-2.0]), {"x": ("-0.4*x",)}, config=config, noise=noise, seed=108)
    assert refinement.warnings == ()
    for start, trajectory in zip(([1.0], [-2.0]), refinement.simulation.trajectories, strict=True):
        values, widths = bands(trajectory)
        assert values.shape == widths.shape == (1, 40)
        assert (np.abs(values - DECAY.values(start, TIMES)) <= 2.3 * widths + 1e-6).all()


def test_constants_stay_as_fitted_where_simple_ones_cannot_be_simulated(monkeypatch):
    monkeypatch.setattr(FittedEquations, "accept_simple_numbers", lambda *_: (DECAY.parsed("exp(900.0*x*x)"),))
    refinement = refined(DECAY, ([1.0], [-2.0]), {"x": ("-0.4*x",)}, noise=0.02, seed=108)
    (constant,) = refinement.equations["x"].constants
    assert constant.value == pytest.approx(constant.fitted, abs=0.1 * constant.std_error)
    assert refinement.simulation is not None


@pytest.mark.slow
@pytest.mark.parametrize("text", ["-0.4*x", "x/(-2.5)"])
def test_the_member_of_the_front_it_was_made_of_is_told_however_it_was_written(text):
    refinement = refined(DECAY, ([1.0], [-2.0]), {"x": ("x", text)}, noise=0.02, seed=108)
    assert is_near(DECAY, refinement, x="-0.5*x")
    assert refinement.equations["x"].member == 1


@pytest.mark.slow
def test_what_the_pool_lacks_is_found_nearby():
    """The damping is missing from all that was handed on, and there are no libraries without sums."""
    starts = ([1.0, 2.0], [0.5, -1.0], [2.0, 0.0])
    refinement = refined(SWING, starts, {"x": ("y",), "y": ("-1.9*x",)}, noise=0.02, seed=103)
    assert is_near(SWING, refinement, x="y", y="-2.0*x - 0.3*y")
    assert refinement.equations["y"].member is None


def test_where_nothing_can_be_simulated_the_fit_to_derivatives_stays():
    """Only functions that explode are handed on, and nothing may be added to them."""
    config = JobConfig(space=SpaceConfig(operators=("exp", "*")))
    pool = {"x": ("exp(9.0*x*x)",), "y": ("exp(9.0*y*y)*exp(3.0*x)",)}
    refinement = refined(LOTKA, LOTKA_STARTS[:2], pool, noise=0.05, config=config)
    assert refinement.warnings == (NOT_SIMULATED,)
    assert refinement.simulation is None
    assert all(equation.alternatives == () and equation.grade is None for equation in refinement.equations.values())
    assert all(math.isfinite(equation.error) for equation in refinement.equations.values())


@pytest.mark.slow
def test_a_known_equation_stays_as_it_is_given():
    config = JobConfig(space=ARITHMETIC, prior=PriorConfig(known={"y": "2.0013*y - x*y - 0.9991*y*y"}))
    pool = {"x": LOTKA_POOL["x"]}
    refinement = refined(LOTKA, LOTKA_STARTS[:3], pool, noise=0.02, seed=104, config=config)
    known = refinement.equations["y"]
    assert sorted(np.abs(known.program.constants[constant_places(known.program)]).tolist()) == [0.9991, 2.0013]
    assert all(constant.fitted is None and constant.interval is None for constant in known.constants)
    assert len(known.alternatives) == 1
    assert is_near(LOTKA, refinement, x="3*x - 2*x*y - x**2")


@pytest.mark.slow
def test_only_allowed_operators_and_variables_come_in():
    all_of_them = ("+", "-", "*", "sin", "cos")
    space = SpaceConfig(operators=all_of_them, operators_of={"x": ("+", "-")}, variables_of={"y": ("y",)})
    refinement = refined(LOTKA, LOTKA_STARTS[:2], {"x": ("x",), "y": ("y",)}, noise=0.05, config=JobConfig(space=space))
    codes = set(refinement.equations["x"].program.operators.tolist())
    assert codes <= {0, 1, *(BY_NAME[name].code for name in ("+", "-", "neg"))}
    y = refinement.equations["y"].program
    assert set(y.left[y.operators == 0].tolist()) <= {1}


@pytest.mark.slow
def test_no_equation_is_larger_than_allowed():
    """Neither candidates nor libraries nor what the descent makes of them."""
    config = JobConfig(space=SpaceConfig(max_size=5))
    refinement = refined(LOTKA, LOTKA_STARTS[:2], LOTKA_POOL, noise=0.05, seed=106, config=config)
    assert refinement.simulation is not None
    assert all(len(equation.program) <= 5 for equation in refinement.equations.values())


def test_a_measured_input_is_part_of_the_model():
    config = JobConfig(space=NO_LIBRARIES, data=DataConfig(inputs=("u",)))
    refinement = refined(
        DRIVEN, ([2.0], [-1.0]), {"x": ("-0.5*x", "1.2*u - 0.5*x")}, noise=0.03, seed=105, config=config
    )
    assert is_near(DRIVEN, refinement, x="1.5*u - 0.8*x")


LEVELS = np.random.default_rng(8).uniform(0.0, 2.0, 200)


def held(t):
    """Return levels that are drawn anew for each row of `TIMES`."""
    return LEVELS[np.minimum(np.floor(t / (TIMES[1] - TIMES[0]) + 1e-6).astype(int), len(LEVELS) - 1)]


@pytest.mark.parametrize("hold", [(), ("u",)])
def test_what_follows_from_an_input_that_is_unknown_between_its_rows_was_not_tested(hold):
    """x and v, which is x's rate, follow from it; y does not."""
    driven = Known(("x", "v", "y"), lambda t, z: [z[1], -2.0 * z[0] - 0.6 * z[1] + 1.5 * held(t), -0.3 * z[2]],
                   {"u": (held, np.zeros_like)})  # fmt: skip
    config = JobConfig(space=NO_LIBRARIES, data=DataConfig(inputs=("u",), hold=hold))
    pool = {"x": ("v",), "v": ("1.5*u - 2.0*x - 0.6*v",), "y": ("-0.3*y",)}
    refinement = refined(driven, ([1.0, 0.0, 2.0],), pool, noise=0.01, seed=105, config=config)
    made = {name: check_of(refinement, name, "inputs between rows") for name in "xvy"}
    assert {name: check.outcome for name, check in made.items()} == {
        "x": "passed" if hold else "not made", "v": "passed" if hold else "not made", "y": "not applicable"
    }  # fmt: skip
    assert hold or "add --hold u if 'u' is constant" in made["x"].reason


def test_what_an_input_makes_between_rows_is_a_share_of_the_rate():
    """An input of 2 whose rows leave 0.002 of it unknown makes little of a rate that x changes by three."""
    points = np.array([np.linspace(1.0, 7.0, 50), np.full(50, 2.0)])
    program = from_infix("1.5*u - 0.8*x", ("x", "u"))
    rate = 1.5 * points[1] - 0.8 * points[0]
    assert share_of_rate(program, points, 1, 0.002) == pytest.approx(0.003**2 / rate.var(), rel=1e-3)
    assert share_of_rate(program, points, 1, 100.0) > 0.99
    assert share_of_rate(program, points, 1, 0.0) == 0.0
    assert math.isnan(share_of_rate(program, points, 1, math.nan))
    near_one = np.array([points[0], np.full(50, 0.95)])
    assert share_of_rate(from_infix("log(1.0 - u) - x", ("x", "u")), near_one, 1, 0.1) == 1.0
    assert share_of_rate(from_infix("x*u*u", ("x", "u")), np.full((2, 50), 0.05), 1, 0.1) > 0.9


@pytest.mark.parametrize("gains", [(2.0, -2.0), (2.0, 2.5)])
def test_of_groups_each_has_its_own_share_of_an_unknown_input(gains):
    """Gains whose mean is zero do not hide it."""
    starts, runs = ([1.0], [2.0], [0.5], [3.0]), []
    for place, start in enumerate(starts):
        gain = gains[place % 2]
        driven = Known(("x",), lambda t, z, gain=gain: [gain * held(t) - 0.9 * z[0]], {"u": (held, np.zeros_like)})
        runs.append(table(driven, (start,), TIMES, 0.01, place))
    columns = np.concatenate([run.columns for run in runs], axis=1)
    batch = np.repeat(np.arange(4.0) % 2, len(TIMES))
    whole = replace(
        table(driven, starts, TIMES),
        names=("t", "x", "u", "batch"),
        units=("",) * 4,
        columns=np.vstack([columns, batch]),
    )
    config = JobConfig(space=NO_LIBRARIES, data=DataConfig(inputs=("u",), group="batch"))
    preparation = prepare(whole, config)
    refinement = refine_all(preparation, config, pools(preparation, x=("1.5*u - 0.9*x",)))
    assert check_of(refinement, "x", "inputs between rows").outcome == "not made"


def test_with_order_2_positions_alone_are_measured():
    """x'' = -2 x - 0.3 x': what is simulated are positions."""
    whole = table(SWING, ([1.0, 2.0], [0.5, -1.0], [2.0, 0.0]), TIMES, 0.01, 106)
    config = JobConfig(space=NO_LIBRARIES, data=DataConfig(order=2, states=("x",)))
    preparation = prepare(whole, config)
    refinement = refine_all(preparation, config, pools(preparation, x=("-1.5*x", "-1.5*x - 0.1*x_dot")))
    positions = Known(("x", "x_dot"), SWING.rates)
    assert is_near(positions, refinement, x="-2.0*x - 0.3*x_dot")
    assert all(bands(trajectory)[0].shape == (1, 40) for trajectory in refinement.simulation.trajectories)
    assert {*refinement.simulation.trajectories[0].start} == {"x", "x_dot"}


def test_data_without_a_law_get_no_good_verdict():
    draw = np.random.default_rng(107)
    noise = table(SWING, ([1.0, 2.0], [0.5, -1.0]), TIMES)
    noise.columns[1:] = draw.standard_normal(noise.columns[1:].shape)
    preparation = prepare(noise, JobConfig(space=ARITHMETIC))
    refinement = refine_all(preparation, JobConfig(space=ARITHMETIC), pools(preparation, x=("y",), y=("x",)))
    assert {equation.grade for equation in refinement.equations.values()} <= {"no model", "doubtful", None}


def test_every_equation_says_where_it_comes_from(noisy):
    for equation in noisy.equations.values():
        assert equation.origin == equation.alternatives[0].origin
        assert {alternative.origin for alternative in equation.alternatives} <= {
            "front",
            "runner-up",
            "library",
            "descent",
        }


def test_origins_are_told_by_structure():
    config = JobConfig(space=ARITHMETIC, prior=PriorConfig(guesses={"y": ("3.5*y*y",)}, known={"z": "x*z"}))
    targets = tuple(Target(name, f"d{name}/dt", np.arange(9.0), 0.0, 1.0) for name in "xyz")
    dataset = Dataset(("x", "y", "z"), np.ones((3, 9)), targets, {name: name for name in "xyz"})

    def programs(*texts):
        return [from_infix(text, ("x", "y", "z")) for text in texts]

    def entries(*texts):
        return tuple(FrontEntry(1, 0.1, 0.1, 0, 0, 0, program.to_bytes()) for program in programs(*texts))

    pools = {"x": Pool(entries("2.5*x"), entries("x + y")), "y": Pool(entries("y", "3*y"))}
    candidates = collect_candidates(dataset, config, pools)
    compared = {"x": programs("2.5*x", "1.5*x + 0.5*x*y"), "y": programs("3.0*y", "x*y")}

    def origins(name, *texts):
        by_structure = candidates[name].origins(compared[name])
        return [by_structure.get(form_key(program)) for program in programs(*texts)]

    texts = ("7.0*x", "x + y", "2.0*x + 0.25*x*y", "x - y")
    assert origins("x", *texts) == ["front", "runner-up", "library", None]
    assert origins("y", "2.0*y*y", "y", "x*y") == ["guess", "front", "library"]
    assert candidates["z"].known == programs("x*z")[0]


class _Counted:
    """A clock that runs by a second each time it is read."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        self.now += 1.0
        return self.now


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.5, 30.0, 300.0])
def test_when_the_time_is_over_the_best_so_far_is_shown_and_that_is_said(seconds):
    """From a deadline that is over at once to one that is over amid the search: equations, and a sentence."""
    config = JobConfig(space=ARITHMETIC)
    preparation = prepare(table(LOTKA, LOTKA_STARTS, TIMES, 0.02, 0), config)
    refinement = refine_all(preparation, config, pools(preparation, **LOTKA_POOL), Deadline(seconds, _Counted()))
    assert refinement.end == "max-time"
    assert any("--max-time" in warning for warning in refinement.warnings)
    assert NOT_SIMULATED not in refinement.warnings
    assert set(refinement.equations) == {"x", "y"}


def test_a_deadline_that_is_not_reached_changes_nothing():
    config = JobConfig(space=NO_LIBRARIES)
    preparation = prepare(table(SWING, ([1.0, 2.0], [0.5, -1.0]), TIMES, 0.02, 0), config)
    pool = pools(preparation, x=("y",), y=("-x", "-1.9*x - 0.35*y"))
    refinement, other = refine_all(preparation, config, pool, Deadline(1e9)), refine_all(preparation, config, pool)
    assert refinement.end == "finished"
    assert refinement.warnings == other.warnings
    assert [equation.program for equation in refinement.equations.values()] == [
        equation.program for equation in other.equations.values()
    ]


def test_a_pole_within_the_data_is_said(monkeypatch):
    monkeypatch.setattr(conclusion, "find_poles", lambda *_: [DECAY.parsed("x - 0.5")])
    refinement = refined(DECAY, ([1.0], [-2.0]), {"x": ("-0.4*x",)}, noise=0.02, seed=108)
    assert refinement.warnings == (
        "The equation of x has a pole within the region that was measured, where x - 0.5 is 0.",
    )


def test_an_equation_whose_simulation_passes_a_pole_is_doubtful(monkeypatch):
    """Between measured points a pole must be earned; from one row to the next no solution goes through it."""
    looked = []
    monkeypatch.setattr(
        trajectory_checks, "find_poles", lambda program, *lines: looked.append(lines) or [program][: len(lines) - 1]
    )
    refinement = refined(DECAY, ([1.0], [-2.0]), {"x": ("-0.4*x",)}, noise=0.02, seed=108)
    assert refinement.equations["x"].grade == "doubtful"
    assert "passes a pole" in refinement.equations["x"].reason
    first, last = looked[0]
    assert first.shape == last.shape == (1, 78)
    assert first[:, 1:39] == pytest.approx(last[:, :38])


def test_constants_are_shown_within_their_intervals(monkeypatch):
    """Where intervals are narrower than what constants are rounded by, a simple number does not take their place."""
    comparison = compare(SWING, measurements(SWING, ([1.0, 2.0], [0.5, -1.0]), TIMES, noise=0.02, seed=110), 1e-5)
    near = comparison.fit_model([from_infix(text, SWING.names) for text in ("1.1*y", "-2.1*x - 0.3*y")])
    shown = _show_equations(comparison, near, near.programs)
    assert 2.0 in np.abs(shown.rounded.programs[1].constants)
    monkeypatch.setattr(final_model, "estimate_errors", lambda *given: narrow(estimate_errors(*given)))
    shown = _show_equations(comparison, near, near.programs)
    assert 2.0 not in np.abs(shown.rounded.programs[1].constants)
    known = describe_constants(
        (), shown.explicit, shown.rounded.programs, narrow(estimate_errors(comparison, shown.free))
    )
    assert all(constant.is_within for equation in known for constant in equation.written)


def narrow(errors):
    return replace(errors, finite_covariance=1e-6 * errors.finite_covariance)


@pytest.mark.parametrize("seed", [7, 11])
def test_constants_keep_few_digits_beside_a_simple_number_that_costs_something(monkeypatch, seed):
    """It is singled out by the covariance, which is larger where errors go together."""
    known = Known(("x",), lambda _, z: [0.31472926535 - 0.5 * z[0]])
    comparison = compare(known, measurements(known, ([2.0], [-1.0]), TIMES, noise=1e-5, seed=seed), 1e-8)
    monkeypatch.setattr(Score, "inflation", lambda *_: 30.0)
    near = comparison.fit_model([known.parsed("0.3 - 0.5*x")])
    shown = _show_equations(comparison, near, near.programs)
    program = shown.rounded.programs[0]
    offset, rate = np.abs(program.constants[constant_places(program)])
    assert shown.fit.misfit > near.misfit + SETTINGS.selection.least_gain
    assert rate == 0.5
    assert abs(offset - 0.31472926535) < 1e-4
    assert len(str(offset)) <= 9


STEADY = Known(("x",), lambda _, z: [1.5])


def test_a_constant_rate_is_no_rival_of_its_own():
    equation = refined(STEADY, ([0.0],), {"x": ("x", "1.5")}, times=0.1 * np.arange(40.0), noise=0.02).equations["x"]
    assert equation.grade == "good", equation.reason


@pytest.mark.parametrize("calls", [400.0, 1500.0])
def test_the_best_system_so_far_is_simulated_when_the_time_to_choose_is_over(calls):
    """The clock counts how often it was asked, so that the end falls between two candidates."""
    asked = itertools.count(1.0)
    config = JobConfig(space=ARITHMETIC)
    preparation = prepare(table(LOTKA, LOTKA_STARTS, TIMES, 0.05, 3), config)
    deadline = Deadline(calls / CHOICE_SHARE, lambda: next(asked))
    refinement = refine_all(preparation, config, pools(preparation, **LOTKA_POOL), deadline)
    assert refinement.end == "max-time"
    assert refinement.simulation is not None


@pytest.mark.slow
def test_bounds_that_lay_out_an_equation_longer_do_not_end_the_search_for_shorter_ones():
    config = JobConfig(space=ARITHMETIC, prior=PriorConfig(bounds={"x": ("c > -1.5",)}))
    refinement = refined(LOTKA, LOTKA_STARTS, LOTKA_POOL, times=0.1 * np.arange(40.0), config=config)
    assert set(refinement.equations) == {"x", "y"}
