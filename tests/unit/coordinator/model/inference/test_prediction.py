"""What a model and its alternatives predict from other initial states within the measured range."""

import math
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from atoll_coordinator.model.inference.prediction import (
    AlternativeSystem as Other,
)
from atoll_coordinator.model.inference.prediction import (
    _differences,
    _Disagreement,
    _OtherInitialStates,
    _r2,
    compare_predictions,
    draw_systems,
)
from atoll_coordinator.model.shooting.points_between import _choose_far_apart, latin_hypercube
from atoll_coordinator.model.shooting.system import system_of
from atoll_coordinator.settings import SETTINGS
from tests.unit.coordinator.model.shooting.made import (
    DECAY,
    DRIVEN,
    LOTKA,
    LOTKA_TEXT,
    SWING,
    Known,
    measurements,
)

TIMES = 0.1 * np.arange(40.0)
WAVE = Known(("x", "y"), lambda _, z: [6.283 * z[1], -6.283 * z[0]])
GROWTH = Known(("x",), lambda _, z: [0.3 * z[0]])
SETTLING = Known(("x",), lambda _, z: [z[0] - z[0] ** 3 / 4.0])
TIMES_OF_GROWTH = 0.1 * np.arange(100.0)
EPIDEMIC = Known(("s", "i", "r"), lambda _, z: [-2.0 * z[0] * z[1], 2.0 * z[0] * z[1] - 0.7 * z[1], 0.7 * z[1]])
STARTS = ([1.0, 3.0], [4.0, 1.0], [8.0, 2.0])


def system(known, *texts):
    return system_of([known.parsed(text) for text in texts], known.names, known.names)


@pytest.fixture(scope="module")
def lotka():
    return measurements(LOTKA, STARTS, TIMES, noise=0.05)


@pytest.fixture(scope="module")
def truth():
    return system(LOTKA, *LOTKA_TEXT)


def test_a_model_without_rivals_is_relied_upon(lotka, truth):
    for prediction in compare_predictions(lotka, truth, [], 1e-6):
        assert (prediction.starts, prediction.followed, prediction.probability, prediction.is_disputed) == (
            12,
            12,
            1.0,
            False,
        )
        assert {*prediction.measure_from} == {"x", "y"}
        assert 0.0 <= prediction.novelty < 0.5


def test_a_rival_that_predicts_the_same_does_not_count(lotka, truth):
    near = system(LOTKA, "3.01*x - 2*x*y - x**2", LOTKA_TEXT[1])
    assert [
        prediction.probability for prediction in compare_predictions(lotka, truth, [Other(near, 0, 1.0, 1.0)], 1e-6)
    ] == [
        1.0,
        1.0,
    ]


def test_a_rival_that_predicts_otherwise_takes_its_share_of_the_odds(lotka, truth):
    other = system(LOTKA, "-0.5*x", LOTKA_TEXT[1])
    x, y = compare_predictions(lotka, truth, [Other(other, 0, 0.25, 0.25)], 1e-6)
    assert x.probability == pytest.approx(0.8)
    assert x.is_disputed
    for name, low, high in (("x", 0.0, 8.0), ("y", 0.0, 3.1)):
        assert low <= x.measure_from[name] <= high
    assert y.probability <= 1.0


def test_rivals_of_two_equations_are_independent(lotka, truth):
    one, other = system(LOTKA, "-0.5*x", LOTKA_TEXT[1]), system(LOTKA, LOTKA_TEXT[0], "-0.5*y")
    x, _ = compare_predictions(lotka, truth, [Other(one, 0, 1.0, 1.0), Other(other, 1, 1.0, 1.0)], 1e-6)
    assert x.probability == pytest.approx(0.25)


def test_rivals_of_one_equation_exclude_one_another(lotka, truth):
    one, other = system(LOTKA, "-0.5*x", LOTKA_TEXT[1]), system(LOTKA, "-0.6*x", LOTKA_TEXT[1])
    x, _ = compare_predictions(lotka, truth, [Other(one, 0, 1.0, 1.0), Other(other, 0, 1.0, 1.0)], 1e-6)
    assert x.probability == pytest.approx(1.0 / 3.0)


def test_a_rival_that_runs_away_predicts_otherwise(lotka, truth):
    other = system(LOTKA, "3*x*x", LOTKA_TEXT[1])
    assert compare_predictions(lotka, truth, [Other(other, 0, 1.0, 1.0)], 1e-6)[0].probability == pytest.approx(0.5)


def test_a_model_that_runs_away_is_followed_nowhere(lotka):
    for prediction in compare_predictions(lotka, system(LOTKA, "30*x*x", "30*y*y"), [], 1e-6):
        assert (prediction.followed, prediction.unfinished, prediction.probability) == (0, 0, 0.0)


def test_what_was_not_measured_is_far():
    """One slow trajectory leaves most of its box unseen; many of them do not."""
    one = measurements(LOTKA, [[8.0, 2.0]], TIMES)
    many = measurements(LOTKA, [[x, y] for x in (1.0, 4.0, 8.0) for y in (0.5, 2.0, 3.0)], TIMES)
    truth = system(LOTKA, *LOTKA_TEXT)
    assert compare_predictions(many, truth, [], 1e-6)[0].novelty < compare_predictions(one, truth, [], 1e-6)[0].novelty


def test_what_goes_beyond_the_measured_range_is_said():
    """A swing measured for a quarter of its period never has x below zero."""
    quarter = measurements(SWING, [[1.0, 0.0]], 0.02 * np.arange(50.0))
    x, _ = compare_predictions(quarter, system(SWING, "y", "-2*x - 0.3*y"), [], 1e-6)
    assert x.reached is not None
    assert x.reached < 0.0
    whole = measurements(SWING, [[1.0, 0.0], [-1.0, 0.5]], TIMES)
    assert compare_predictions(whole, system(SWING, "-0.1*x", "-0.1*y"), [], 1e-6)[0].reached is None


@pytest.mark.parametrize(("times", "is_left"), [(0.02 * np.arange(50.0), True), (TIMES, False)])
def test_beyond_the_measured_range_a_rival_has_the_odds_that_the_data_give_it(times, is_left):
    """A rival that is less plausible, and fits as well, where x goes beyond, or not."""
    rows = measurements(SWING, [[1.0, 0.0]], times)
    rival = Other(system(SWING, "y", "-0.5*x - 0.3*y"), 1, 1e-3, 1.0)
    x, _ = compare_predictions(rows, system(SWING, "y", "-2*x - 0.3*y"), [rival], 1e-6)
    assert (x.reached is not None) == is_left
    assert x.probability == pytest.approx(0.5 if is_left else 0.999, abs=1e-3)
    assert x.is_disputed


def test_a_process_that_leaves_the_measured_range_as_it_was_measured_to_is_followed_so_far():
    """Growth measured to 20 leads from 10 to 200; nothing says that it should not, nor that it should."""
    grown = measurements(GROWTH, [[1.0]], TIMES_OF_GROWTH)
    truth = system(GROWTH, "0.3*x")
    (prediction,) = compare_predictions(grown, truth, [], 1e-6)
    assert (prediction.starts, prediction.followed) == (12, 12)
    rival = system(GROWTH, "0.3*x + 0.0001*x*x")
    assert compare_predictions(grown, truth, [Other(rival, 0, 1.0, 1.0)], 1e-6)[0].probability == 1.0
    other = system(GROWTH, "0.1*x*x")
    assert compare_predictions(grown, truth, [Other(other, 0, 1.0, 1.0)], 1e-6)[0].probability == 0.5


@pytest.mark.parametrize(
    ("known", "model"),
    [("growth", "-60"), ("decay", "0.5*x"), ("both", "0.3*x*x*x")],
    ids=lambda text: str(text),
)
def test_a_process_that_leaves_on_another_side_runs_away(known, model):
    """Growth and decay end at one end of the range; of both together the one begins where the other ends."""
    systems = {"growth": (GROWTH, [[1.0]]), "decay": (DECAY, [[2.0]]), "both": (SETTLING, [[-1.0], [1.0]])}
    known_system, starts = systems[known]
    prediction = compare_predictions(
        measurements(known_system, starts, TIMES_OF_GROWTH), system(known_system, model), [], 1e-6
    )[0]
    assert prediction.followed < prediction.starts


def test_a_measured_row_of_a_fast_oscillator_is_allowed_its_steps():
    """Five hundred rows, ten to a period: the hundred that are looked at would have a fifth of the steps."""
    fast = measurements(WAVE, [[1.0, 0.0]], 0.1 * np.arange(500.0))
    truth = system(WAVE, "6.283*y", "-6.283*x")
    assert [
        (prediction.followed, prediction.unfinished) for prediction in compare_predictions(fast, truth, [], 1e-10)
    ] == [
        (12, 0),
        (12, 0),
    ]


def test_running_out_of_steps_is_said_to_be_that(lotka, truth):
    fast = system(LOTKA, "6000*(y - 2)", "-6000*(x - 2)")
    for prediction in compare_predictions(lotka, fast, [], 1e-6):
        assert (prediction.starts, prediction.followed, prediction.unfinished) == (12, 0, 12)
    x, _ = compare_predictions(lotka, truth, [Other(fast, 0, 1.0, 1.0)], 1e-6)
    assert (x.probability, x.is_disputed) == (1.0, False)


def test_what_a_rival_predicts_where_it_has_enough_steps_counts(lotka, truth):
    """It turns the faster the farther away it begins, at the rate that it keeps."""
    partly = system(LOTKA, "500*(x**2 + y**2 - 1)**3*(y - 2)", LOTKA_TEXT[1])
    x, _ = compare_predictions(lotka, truth, [Other(partly, 0, 1.0, 1.0)], 1e-6)
    assert (x.probability, x.is_disputed) == (0.5, True)


def spread_of(rows):
    return _OtherInitialStates(rows, 1e-6, is_near=False).starts


def test_initial_states_keep_what_all_measured_ones_have_in_common():
    whole = measurements(EPIDEMIC, [[0.99, 0.01, 0.0], [0.6, 0.3, 0.1]], TIMES)
    starts = spread_of(whole)
    assert starts.sum(axis=1) == pytest.approx(np.ones(12))
    assert starts.min() >= 0.0
    assert (starts.max(axis=0) - starts.min(axis=0) > 0.3 * np.ptp(whole.smoothed, axis=1)).all()


def test_of_many_states_none_is_near_the_corners_and_none_stays_near_one_end():
    rng = np.random.default_rng(2)
    rows = measurements(WAVE, [[1.0, 0.0]], TIMES)
    cloud = rng.standard_normal((40, 4000))
    starts = spread_of(replace(rows, smoothed=cloud, times=0.1 * np.arange(4000.0), bounds=np.array([[0, 4000]])))
    assert np.linalg.norm(starts, axis=1).max() <= np.linalg.norm(cloud, axis=0).max()
    assert (np.ptp(starts, axis=0) > 0.2 * np.ptp(cloud, axis=1)).all()


def test_ten_right_pendulums_are_relied_upon():
    """In a corner of the box of all ten, each would be at its largest angle and speed, and most would turn over."""
    count, angles = 10, [f"a{index}" for index in range(10)]
    names = (*angles, *(f"s{index}" for index in range(count)))
    squares = 1.0 + 0.15 * np.arange(count)
    pendulums = Known(names, lambda _, z: [*z[count:], *(-squares * np.sin(z[:count]))])
    start = [*np.linspace(1.5, 2.6, count), *np.zeros(count)]
    rows = measurements(pendulums, [start], 0.1 * np.arange(300.0))
    right = system(
        pendulums, *names[count:], *(f"-{c!r}*sin({a})" for a, c in zip(angles, squares.tolist(), strict=True))
    )
    for prediction in compare_predictions(rows, right, [], 1e-6):
        assert (prediction.starts, prediction.followed, prediction.probability) == (12, 12, 1.0)


def test_however_long_a_process_rests_the_way_there_is_begun_from():
    resting = measurements(SWING, [[1.0, 0.0]], np.linspace(0.0, 400.0, 4001))
    assert np.median(np.linalg.norm(spread_of(resting), axis=1)) > 0.2


@pytest.mark.parametrize(("rows_a_period", "rows"), [(10, 5000), (20, 10_000)])
def test_rows_in_step_with_a_period_are_not_one_state(rows_a_period, rows):
    """Every tenth and every twentieth of these rows are the same state."""
    times = np.arange(float(rows)) / rows_a_period
    phases = 2.0 * np.pi * (np.arange(rows) % rows_a_period) / rows_a_period
    cycle = np.array([np.cos(phases), -np.sin(phases)])
    measured = measurements(WAVE, [[1.0, 0.0]], TIMES)
    measured = replace(measured, smoothed=cycle, times=times, bounds=np.array([[0, rows]]))
    region = _OtherInitialStates(measured, 1e-6, is_near=False)
    assert (np.ptp(region.starts, axis=0) > 1.0).all()
    (distances,) = region.distances_from_measured([cycle[:, : 4 * rows_a_period]])
    assert distances.max() < 1e-12


def test_each_part_of_each_dimension_has_one_point():
    points = latin_hypercube(12, 3)
    assert points.shape == (12, 3)
    assert np.sort(np.floor(12.0 * points), axis=0).T.tolist() == [[*range(12)]] * 3
    assert (latin_hypercube(12, 3) == points).all()


def test_with_inputs_other_initial_states_take_those_of_a_measured_trajectory():
    """A rival with another answer to the input is found, and a model that runs away with it as well."""
    driven = measurements(DRIVEN, [[1.0]], TIMES)
    law, other = (system_of([DRIVEN.parsed(text)], DRIVEN.names, DRIVEN.names) for text in ("-0.8*x + 1.5*u", "-0.8*x"))
    (prediction,) = compare_predictions(driven, law, [Other(other, 0, 1.0, 1.0)], 1e-6)
    assert prediction.followed == prediction.starts
    assert prediction.probability < 0.6
    (alone,) = compare_predictions(driven, law, [], 1e-6)
    assert alone.probability == 1.0
    runaway = system_of([DRIVEN.parsed("9*x + 1.5*u")], DRIVEN.names, DRIVEN.names)
    assert compare_predictions(driven, runaway, [], 1e-6)[0].followed < 12


def test_with_groups_other_initial_states_take_the_constants_of_a_group_in_turn():
    """One group decays and the other grows: with the constants of one of them, half of the courses run away."""
    grouped = replace(measurements(DECAY, [[2.0], [2.0]], TIMES), groups=np.array([0, 1]))
    whole = system(DECAY, "-0.5*x")
    sharing = whole.sharing_numbers(np.array([whole.constants, whole.constants]), (), 0)
    assert compare_predictions(grouped, sharing, [], 1e-6)[0].followed == 12
    growing = sharing.with_values(np.array([-0.5, 5.0]))
    assert compare_predictions(grouped, growing, [], 1e-6)[0].followed == 6


def test_with_groups_an_initial_state_lies_between_states_of_its_group():
    """What one group never comes near says nothing of its constants."""
    grouped = replace(measurements(DECAY, [[2.0], [200.0]], TIMES), groups=np.array([0, 1]))
    starts = _OtherInitialStates(grouped, 1e-6, is_near=False).starts[:, 0]
    assert (starts[::2] <= 2.0).all()
    assert (starts[1::2] > 0.9 * 200.0 * np.exp(-0.5 * TIMES[-1])).all()


def test_draws_spread_as_the_covariance_says():
    fitted = system(DECAY, "-0.5*x")
    drawn = np.array([draw.values for draw in islice(draw_systems(fitted, np.array([[0.01]])), 12)])
    assert 0.03 < drawn.std() < 0.3


@pytest.mark.parametrize("scale", [1e-12, 1e12])
def test_draws_in_other_units_are_the_same_draws(scale):
    """Eigenvectors of a covariance of 1e42 beside 1e-24 would be those of its rounding errors."""
    fitted = system(LOTKA, "3.5*x - 2.5*x*y", "0.5*y")
    units = np.array([scale, 1.0 / scale, 1.0])
    covariance = np.array([[4.0, 1.0, 0.0], [1.0, 1.0, 0.1], [0.0, 0.1, 0.25]]) * 1e-4
    scaled = fitted.with_values(fitted.values * units)
    there = [draw.values / units for draw in islice(draw_systems(scaled, covariance * np.outer(units, units)), 12)]
    for own, other in zip(draw_systems(fitted, covariance), there, strict=False):
        assert own.values == pytest.approx(other, rel=1e-9)


def test_a_system_without_constants_has_no_draws():
    assert not [*draw_systems(system(DECAY, "x"), np.zeros((0, 0)))]


COUNT = SETTINGS.shooting.lengths[-1]
"""Rows of a course from another initial state."""


@pytest.mark.parametrize(
    ("wrong", "taken", "probability"),
    [(set(), 38, 1.0), (set(range(40)), 12, 1 / 13), ({5}, 77, 77 / 78), (set(range(10, 144, 20)), 144, 1.0 - 7 / 145)],
)
def test_constants_are_drawn_until_the_claim_is_decided(lotka, truth, wrong, taken, probability):
    """Of 38 that all agree a share of 0.95 is likely; where one in twenty differs no number would decide."""
    other, asked = system(LOTKA, "-0.5*x", LOTKA_TEXT[1]), []
    drawn = (asked.append(place) or (other if place in wrong else truth) for place in range(1000))
    x, _ = compare_predictions(lotka, truth, [], 1e-6, drawn)
    assert (len(asked), x.probability) == (taken, pytest.approx(probability))


def test_courses_last_as_long_as_the_longest_trajectory_and_are_allowed_its_rows(truth):
    three = measurements(LOTKA, STARTS, TIMES)
    bounds, owners = np.array([[0, 20], [20, 60], [60, 100], [100, 120]]), np.array([0, 1, 1, 2])
    times = np.concatenate([TIMES[:20], 7.0 + 0.1 * np.arange(80.0), TIMES[:20]])
    region = _OtherInitialStates(replace(three, bounds=bounds, owners=owners, times=times), 1e-6, is_near=False)
    along = region._estimator(0).measurements.times
    assert (len(along), along[0], along[-1]) == (COUNT, 0.0, pytest.approx(7.9))
    assert {course.shape for course in region.simulate(truth, range(12))} == {(2, COUNT)}


def test_without_a_dispute_the_next_measurement_is_where_courses_are_farthest_from_the_measured(truth):
    one = measurements(LOTKA, [[8.0, 2.0]], TIMES)
    elsewhere = _OtherInitialStates(one, 1e-6, is_near=False)
    distances = elsewhere.distances_from_measured(elsewhere.simulate(truth, range(12)))
    assert min(distance.min() for distance in distances) >= 0.0
    x, _ = compare_predictions(one, truth, [], 1e-6)
    assert not x.is_disputed
    assert x.novelty == pytest.approx(np.median(np.concatenate(distances)))
    assert x.measure_from == elsewhere.initial_state(int(np.argmax([distance.max() for distance in distances])))


def test_a_distance_is_the_largest_share_of_a_width_to_the_nearest_row():
    rows = measurements(SWING, [[1.0, 0.0]], TIMES)
    elsewhere = _OtherInitialStates(rows, 1e-6, is_near=False)
    width = np.ptp(rows.smoothed, axis=1)
    (distances,) = elsewhere.distances_from_measured(
        [np.tile((rows.smoothed[:, :1] + 2.0 * width[:, None] * [[0.0], [1.0]]), 8)]
    )
    assert len(distances) == 2
    high = (rows.smoothed[1, 0] + 2.0 * width[1] - rows.smoothed[1]) / width[1]
    nearest = np.maximum(high, np.abs(rows.smoothed[0, 0] - rows.smoothed[0]) / width[0]).min()
    assert distances == pytest.approx(np.full(2, nearest))


def test_near_measured_states_means_a_thousandth_of_their_deviation_away(lotka):
    starts = _OtherInitialStates(lotka, 1e-6, is_near=True).starts
    rows = np.linspace(0, lotka.rows - 1, 12).astype(int)
    away = (starts - lotka.smoothed[:, rows].T) / lotka.scales
    assert away == pytest.approx(np.full((12, 2), SETTINGS.common.negligible))


def test_of_what_lies_beyond_the_range_the_farther_end_is_said():
    quarter = measurements(SWING, [[-1.0, 0.0]], 0.02 * np.arange(50.0))
    x, _ = compare_predictions(quarter, system(SWING, "y", "-2*x - 0.3*y"), [], 1e-6)
    assert x.reached is not None
    assert x.reached > 0.0
    elsewhere = _OtherInitialStates(quarter, 1e-6, is_near=False)
    low, high = float(quarter.smoothed[0].min()), float(quarter.smoothed[0].max())
    for below, above in ((0.3, 0.2), (0.2, 0.3)):
        values = [np.array([[low - below * (high - low), high + above * (high - low)]])]
        assert elsewhere.farthest_value(values, 0) == pytest.approx(values[0][0, int(above > below)])
    assert elsewhere.farthest_value([np.array([[low - 0.09 * (high - low), high + 0.09 * (high - low)]])], 0) is None


def test_chaos_ends_what_can_be_predicted(truth):
    rows = measurements(LOTKA, STARTS, TIMES)
    elsewhere = _OtherInitialStates(rows, 1e-6, is_near=False)
    courses = elsewhere.simulate(truth, range(12))
    assert elsewhere.horizon(truth, courses) == COUNT
    lost = [course + (np.arange(COUNT) >= COUNT // 4) * 10.0 for course in courses]
    assert elsewhere.horizon(truth, lost) == COUNT // 4
    assert elsewhere.horizon(truth, ["ran away", *lost[1:]]) == COUNT // 4
    assert elsewhere.horizon(truth, ["ran away"] * 12) == COUNT


def test_a_long_chaotic_recording_is_compared_up_to_its_own_horizon():
    """Lorenz's system for 400 of its Lyapunov times: an alternative that differs by a millionth agrees, one that
    differs by a tenth does not."""
    text = ("10*(y - x)", "x*({} - z) - y", "x*y - 8/3*z")
    lorenz = Known(
        ("x", "y", "z"),
        lambda _, u: [10 * (u[1] - u[0]), u[0] * (28 - u[2]) - u[1], u[0] * u[1] - 8 / 3 * u[2]],
    )
    rows = measurements(lorenz, ([1.0, 2.0, 20.0],), 0.05 * np.arange(8_000.0))
    own, near, far = (system(lorenz, text[0], text[1].format(size), text[2]) for size in (28, 28.00003, 31))
    for other, probability in ((near, 1.0), (far, 0.5)):
        found = compare_predictions(rows, own, [Other(other, 0, 1.0, 1.0)], 1e-6, is_near=True)
        assert [one.probability for one in found] == [probability] * 3


@pytest.mark.parametrize(("height", "rows"), [(0.2, COUNT), (0.3, COUNT // 2), (0.4, COUNT // 4)])
def test_what_can_be_predicted_ends_where_a_tenth_of_the_variance_is_lost(monkeypatch, lotka, truth, height, rows):
    """A step of one of the states after a quarter of a wave that goes back and forth between -1 and 1."""
    elsewhere = _OtherInitialStates(lotka, 1e-6, is_near=False)
    wave = np.tile(np.sin(np.arange(float(COUNT))), (2, 1))
    step = np.array([[height], [0.0]]) * (np.arange(COUNT) >= COUNT // 4)
    monkeypatch.setattr(elsewhere, "_simulate", lambda *_: wave + step)
    assert elsewhere.horizon(truth, [wave] * 12) == rows


def test_what_a_rival_predicts_after_chaos_has_set_in_does_not_count(monkeypatch, lotka, truth):
    slower = Other(system(LOTKA, "2*x - 2*x*y - x**2", LOTKA_TEXT[1]), 0, 1.0, 1.0)
    assert compare_predictions(lotka, truth, [slower], 1e-6)[0].probability == 0.5
    monkeypatch.setattr(_OtherInitialStates, "horizon", lambda *_: 10)
    assert compare_predictions(lotka, truth, [slower], 1e-6)[0].probability == 1.0


def test_chaos_is_looked_for_a_thousandth_of_the_deviation_away_in_any_unit(monkeypatch, truth):
    small = measurements(LOTKA, STARTS, TIMES)
    small = replace(small, smoothed=1e-6 * small.smoothed, scales=1e-6 * small.scales)
    elsewhere = _OtherInitialStates(small, 1e-6, is_near=False)
    own = [np.tile(np.sin(np.arange(float(COUNT))), (2, 1))] * 12
    asked, answers = [], iter([*own[:6], *["ran away"] * 6])
    monkeypatch.setattr(elsewhere, "_simulate", lambda _, _place, start: asked.append(start) or next(answers))
    assert elsewhere.horizon(truth, own) == COUNT
    away = (np.array(asked) - elsewhere.starts) / small.scales
    assert np.abs(away) == pytest.approx(np.full((12, 2), SETTINGS.common.negligible))


def test_a_rival_is_disputed_where_it_weighs_most(lotka, truth):
    """Of equal odds the one that predicts the farther course; of the start, that where it is the farthest."""
    elsewhere = _OtherInitialStates(lotka, 1e-6, is_near=False)
    other = system(LOTKA, "-0.5*x", LOTKA_TEXT[1])
    own, theirs = (elsewhere.simulate(courses_system, range(12)) for courses_system in (truth, other))
    sizes = [np.abs(one[0] - two[0]).max() for one, two in zip(own, theirs, strict=True)]
    for odds in (0.25, 1.0):
        x, _ = compare_predictions(lotka, truth, [Other(other, 0, odds, odds)], 1e-6)
        assert x.measure_from == elsewhere.initial_state(int(np.argmax(sizes)))


@pytest.mark.parametrize("unit", [1.0, 1e-9, 1e9])
def test_r2_is_of_all_courses_together(unit):
    true = [unit * np.array([[0.0, 1.0, 2.0], [5.0, 5.0, 5.0]]), unit * np.array([[3.0, 4.0], [5.0, 5.0]])]
    courses = [true[0], true[1] + unit * np.array([[1.0, -1.0], [0.0, 0.0]])]
    assert _r2(courses, true) == pytest.approx([0.8, 1.0])


def test_a_state_that_does_not_change_is_predicted():
    still = Known(("x", "y"), lambda _, z: [-0.5 * z[0], 0.0])
    _, y = compare_predictions(measurements(still, [[2.0, 1.0]], TIMES), system(still, "-0.5*x", "0*y"), [], 1e-6)
    assert (y.followed, y.probability, y.reached) == (12, 1.0, None)
    assert 0.0 < y.novelty < 0.1


RAMP = np.array([[0.0, 0.1, 0.2, 0.3]])


@pytest.mark.parametrize(
    ("courses", "agreement", "place"),
    [
        ([RAMP, RAMP], 1.0, None),
        (["ran away", RAMP], 0.5, 0),
        ([RAMP, "ran away"], 0.5, 1),
        (["out of steps", RAMP], 1.0, None),
        (["out of steps", RAMP + 0.9], 0.5, 1),
        ([RAMP + 0.9, "out of steps"], 0.5, 0),
        ([RAMP + 0.9, "ran away"], 0.5, 1),
        (["out of steps", "out of steps"], 1.0, None),
    ],
)
def test_a_rival_that_runs_away_from_one_state_alone_predicts_otherwise_there(courses, agreement, place):
    misses, differences = _Disagreement(1), _differences(courses, [RAMP, RAMP], 1)
    if differences is not None:
        misses.add(0, 1.0, *differences)
    assert (misses.agreement(0), misses.most_disputed_place(0)) == (agreement, place)


def test_draws_of_constants_that_go_together_are_numbers():
    """Rounding leaves such a covariance an eigenvalue below 0."""
    fitted = system(LOTKA, "3.5*x - 2.5*x*y", "0.5*y")
    covariance = 1e-4 * (np.ones((3, 3)) + 1e-12 * (1.0 - np.eye(3)))
    drawn = np.array([draw.values - fitted.values for draw in islice(draw_systems(fitted, covariance), 12)])
    assert drawn == pytest.approx(np.tile(drawn[:, :1], 3), abs=1e-7)
    assert 0.003 < drawn.std() < 0.03


def test_draws_have_the_covariance_that_they_are_given():
    fitted = system(LOTKA, "3.5*x - 2.5*x*y", "0.5*y")
    covariance = np.array([[4.0, 1.9, 0.0], [1.9, 1.0, 0.1], [0.0, 0.1, 0.25]]) * 1e-4
    drawn = np.array([draw.values for draw in islice(draw_systems(fitted, covariance), 12)]) - fitted.values
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), drawn.T)
    assert 18.0 < (whitened**2).sum() < 60.0  # chi squared of 36: 0.5 % at either side
    covariance[2], covariance[:, 2] = 0.0, 0.0
    assert {draw.values[2] for draw in islice(draw_systems(fitted, covariance), 12)} == {fitted.values[2]}


def test_points_far_apart_are_as_far_from_those_before_as_any():
    assert _choose_far_apart(np.array([[0.0], [1.0], [10.0], [4.0]]), 3) == [0, 2, 3]
    assert _choose_far_apart(np.zeros((5, 2)), 3) == [0]


# ------------------------------------------------------------------------------- leaving the measured range


def elsewhere(known, starts, times):
    return _OtherInitialStates(measurements(known, starts, times), 1e-6, is_near=False)


@pytest.mark.parametrize(
    ("last", "leaves"),
    [((9.0,), False), ((19.9,), False), ((21.0,), True), ((1e3,), True), ((0.9,), False), ((-1e3,), False)],
)
def test_growth_is_left_at_its_upper_end_alone(last, leaves):
    """Measured from 1 to 20: the trajectory ends at the upper end, and begins at the lower one."""
    region = elsewhere(GROWTH, [[1.0]], np.linspace(0.0, math.log(20.0) / 0.3, 100))
    assert region._leaves_as_measured(np.array([[3.0, *last]])) is leaves
    assert region._leaves_as_measured(np.empty((1, 0))) is False


@pytest.mark.parametrize(("last", "leaves"), [(0.01, True), (0.5, False), (2.5, False)])
def test_decay_is_left_at_its_lower_end_alone(last, leaves):
    region = elsewhere(DECAY, [[2.0]], np.linspace(0.0, 5.0, 50))
    assert region._leaves_as_measured(np.array([[1.0, last]])) is leaves


@pytest.mark.parametrize(
    ("x", "y", "leaves"),
    [
        (30.0, 2.4, True),
        (30.0, 5.0, True),
        (30.0, 6.0, False),
        (30.0, 1e3, False),
        (30.0, -1e3, False),
        (0.5, 2.1, False),
    ],
)
def test_the_state_that_is_farthest_out_for_its_range_tells_how_a_course_leaves(x, y, leaves):
    """Of two states one grows to the end of its range, the other goes back and forth."""
    both = Known(("x", "y"), lambda _, z: [0.3 * z[0], 2.0 * math.cos(z[0])])
    region = elsewhere(both, [[1.0, 2.0]], np.linspace(0.0, 10.0, 100))
    assert region._measurements.smoothed[1, -1] < region._measurements.smoothed[1].max()
    assert region._leaves_as_measured(np.array([[2.0, x], [2.0, y]])) is leaves


@pytest.mark.parametrize("last", [[-9.0, 0.3], [9.0, 0.3], [0.3, -9.0], [0.3, 9.0]])
def test_a_swing_that_comes_to_rest_within_its_range_is_left_nowhere(last):
    region = elsewhere(SWING, [[0.1, 0.0]], TIMES)
    assert region._leaves_as_measured(np.array([last]).T) is False


def test_one_trajectory_that_ends_at_the_end_of_the_range_is_enough():
    region = elsewhere(GROWTH, [[1.0], [20.0]], np.linspace(0.0, math.log(20.0) / 0.3, 100))
    assert region._leaves_as_measured(np.array([[300.0, 1e3]])) is True


def test_a_course_that_leaves_on_another_side_is_not_followed_for_a_while():
    """From near the end of a decay little was measured, and a growth is small for so long; it is one all the same."""
    region = elsewhere(DECAY, [[2.0]], TIMES_OF_GROWTH)
    assert region.simulate_model(system(DECAY, "0.5*x")) == ["ran away"] * 12
    assert region._rows == {}


@pytest.mark.parametrize(
    ("start", "of_hundred"), [(1.0, 100), (4.47, 50), (19.9, 1), (20.5, 99), (89.4, 50), (400.0, 1)]
)
def test_a_course_is_followed_for_as_long_as_was_measured_from_the_nearest_state(start, of_hundred):
    """Two trajectories: one from 1 to 20 in the whole time, the other from 20 to 400 in as long."""
    times = np.linspace(0.0, math.log(20.0) / 0.3, 201)
    region = elsewhere(GROWTH, [[1.0], [20.0]], times)
    assert region._rows_measured_from(np.array([start])) == pytest.approx(of_hundred, abs=1)


def test_the_nearest_state_is_near_in_all_that_is_measured():
    """A swing is at each place again and again, with another speed, here in thousandths."""
    fine = Known(("x", "y"), lambda _, z: [0.001 * z[1], -2000.0 * z[0] - 0.3 * z[1]])
    region = elsewhere(fine, [[1.0, 0.0]], TIMES)
    start = region._measurements.smoothed[:, 18] + region._width * [0.01, 0.04]
    assert region._rows_measured_from(start) == pytest.approx(COUNT * 21 / 39, abs=1)


def test_beside_smoothed_states_other_initial_states_are_near_those_of_trajectories():
    """A tenth of the way to others: farther away the smoothed state would not be as it was measured."""
    rows = replace(measurements(DRIVEN, ([1.0], [3.0]), TIMES), has_smoothed_inputs=True)
    near, far = (
        _OtherInitialStates(rows, 1e-6, is_near=False).starts,
        spread_of(replace(rows, has_smoothed_inputs=False)),
    )
    begun = np.array([[1.0], [3.0]] * (len(near) // 2))
    assert np.abs(near - begun) == pytest.approx(0.1 * np.abs(far - begun), abs=1e-6)
    assert len(np.unique(near, axis=0)) > 2
