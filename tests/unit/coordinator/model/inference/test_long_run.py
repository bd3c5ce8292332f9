"""Chaotic models are judged by what chaos allows: a right one keeps the measured averages, a wrong one does not."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from atoll_coordinator.model.inference import long_run
from atoll_coordinator.model.inference.long_run import (
    _block_means,
    _welch_probabilities,
    compare_averages,
    make_simulator,
)
from atoll_coordinator.model.shooting.measurements import measurements_of
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.model.shooting.system import system_of
from atoll_core.expression.text.parsing import from_infix
from tests.unit.coordinator.model.sparse.lorenz import NAMES, prepared

TRUTH = ("10*(y - x)", "28*x - x*z - y", "x*y - 2.6666666666666665*z")


@pytest.fixture(scope="module")
def measured():
    return measurements_of(prepared(2000, 0.01, trajectories=2).recording, [0, 1, 2], piece=50)


def made(texts):
    system = system_of([from_infix(text, NAMES) for text in texts], NAMES, NAMES)
    return system.with_fixed_constants()


def looked(measured, texts, shown=None):
    fit = MultipleShooting(measured, 1e-6).fit(made(texts), None, 0)
    return compare_averages(replace(fit, system=made(shown or texts)), 0.9, 1e-6)


@pytest.mark.slow
def test_the_truth_stays_on_the_attractor(measured):
    seen = looked(measured, TRUTH)
    assert seen.is_kept
    assert seen.lyapunov_time == pytest.approx(1.0 / 0.9)


@pytest.mark.parametrize("other", ["23*x - x*z - y", "35*x - x*z - y"])
def test_another_attractor_is_told_by_means_and_variances(measured, other):
    seen = looked(measured, (TRUTH[0], other, TRUTH[2]))
    assert not seen.is_kept
    assert seen.probability < 1e-3


@pytest.mark.slow
def test_the_way_to_the_attractor_does_not_count():
    rows = measurements_of(prepared(500, 0.01, trajectories=8).recording, [0, 1, 2], piece=50)
    smoothed, count = rows.smoothed.copy(), len(rows.times) // 8
    for first in range(0, 8 * count, count):
        smoothed[:, first : first + count // 2] += 50.0
    assert looked(replace(rows, smoothed=smoothed), TRUTH).is_kept


def test_a_simulation_that_takes_too_many_steps_does_not_run_away(measured):
    seen = looked(measured, TRUTH, ("60000*y", "-60000*x", "-z"))
    assert (seen.is_kept, seen.is_unfinished, seen.probability) == (False, True, None)
    assert seen.lyapunov_time == pytest.approx(1.0 / 0.9)


@pytest.mark.slow
@pytest.mark.parametrize("rows", [2000, 20_000])
def test_ours_has_blocks_enough_to_know_its_variance_however_many_rows_were_measured(monkeypatch, rows):
    """Of 8,000 rows and more a simulation of 4,000 had one block, whose mean was taken for exact."""
    blocks = []
    monkeypatch.setattr(
        long_run, "_welch_probabilities", lambda *both: [blocks.append([part.shape for part in both]) or 1.0]
    )
    measured = measurements_of(prepared(2000, 0.01, trajectories=1).recording, [0, 1, 2], piece=50)
    looked(several(measured, rows // 2000), TRUTH)
    assert blocks == [[(3, 4), (3, 4)]] * 2


def test_of_a_driven_model_nothing_is_said():
    measured = SimpleNamespace(inputs=np.zeros((1, 5)))
    assert compare_averages(SimpleNamespace(estimator=SimpleNamespace(measurements=measured)), 0.9, 1e-6) is None


def test_the_long_simulation_begins_where_the_last_trajectory_ended(monkeypatch):
    asked = []
    estimator = SimpleNamespace(measurements=None, simulate=lambda _, start: start.tolist())
    monkeypatch.setattr(
        long_run, "make_simulator", lambda _, times, *rest: asked.append([times.tolist(), *rest]) or estimator
    )
    fit = SimpleNamespace(estimator=estimator, system=None, simulated=np.arange(6.0).reshape(2, 3))
    assert long_run._simulate_long_run(fit, 6, 2, 0.5, 1e-6) == [2.0, 5.0]
    assert asked == [[[0.0, 1.0, 2.0], 1e-6, 6]]


@pytest.fixture
def compared(monkeypatch):
    """Return a function of the rows of trajectories: what is simulated for them, and the block means compared with it.

    Measured are 5 in the first half of each and 1 in the second, every 0.5 until a gap; simulated is 2.
    """
    asked, means = [], []

    def simulated(_, rows, stride, step, tolerance):
        asked.append((rows, stride, step, tolerance))
        return np.full((1, -(-rows // stride)), 2.0)

    def of(*lengths):
        measured = SimpleNamespace(
            inputs=(),
            rows=sum(lengths),
            times=np.concatenate([np.append(0.5 * np.arange(rows - 1.0), 1e5) for rows in lengths]),
            owners_of_rows=np.repeat(np.arange(len(lengths)), lengths),
            smoothed=np.concatenate([np.where(np.arange(rows) < rows // 2, 5.0, 1.0) for rows in lengths])[None],
        )
        assert compare_averages(SimpleNamespace(estimator=SimpleNamespace(measurements=measured)), 0.9, 1e-6).is_kept
        return asked.pop(), [means.pop(0), means.pop(0)]

    monkeypatch.setattr(long_run, "_simulate_long_run", simulated)
    monkeypatch.setattr(
        long_run, "_welch_probabilities", lambda *both: [means.append([part.tolist() for part in both]) or 1.0]
    )
    return of


def test_of_few_trajectories_quarters_of_the_longest_are_compared(compared):
    asked, (first, second) = compared(80, 40, 40)
    assert asked == (160, 1, 0.5, 1e-6)
    assert first == [[[-1.0] * 8], [[2.0, 2.0, -2.0, -2.0, 2.0, -2.0, 2.0, -2.0]]]
    assert second == [[[1.0] * 8], [[4.0] * 8]]


def test_of_many_trajectories_later_halves_are_compared(compared):
    asked, (first, second) = compared(40, 40, 40, 80)
    assert asked == (200, 1, 0.5, 1e-6)
    assert first == second == [[[1.0] * 5], [[0.0] * 4]]


@pytest.mark.parametrize(("lengths", "asked"), [((18_000,), (18_000, 5)), ((100, 2, 2, 2), (200, 1))])
def test_a_simulation_is_as_long_as_four_blocks(compared, lengths, asked):
    judgement, ((ours, _), _) = compared(*lengths)
    assert judgement[:2] == asked
    assert len(ours[0]) == 4


def several(rows, count):
    """Return the same rows again and again, as if they were of one trajectory."""
    numbers = ("measured", "weights", "smoothed", "inputs", "input_slopes")
    ends = np.arange(count)[:, None, None] * rows.rows
    return replace(
        rows,
        bounds=(ends + rows.bounds).reshape(-1, 2),
        owners=np.tile(rows.owners, count),
        times=0.01 * np.arange(float(count * rows.rows)),
        inverse_variances=None,
        **{name: np.tile(getattr(rows, name), count) for name in numbers},
    )


def test_a_simulation_that_runs_away_is_not_kept(measured):
    seen = looked(measured, ("0.3*x", "0.3*y", "0.3*z"))
    assert (seen.is_kept, seen.probability) == (False, None)


def test_means_are_of_whole_blocks():
    values = np.array([[1.0, 3.0, 5.0, 7.0, 100.0], [0.0, 0.0, 1.0, 1.0, 100.0]])
    assert _block_means(values, 2).tolist() == [[2.0, 6.0], [0.0, 1.0]]
    assert _block_means(values[:, :3], 4).tolist() == [[3.0], [pytest.approx(1.0 / 3.0)]]


def test_means_are_compared_as_welch_does():
    from scipy import stats

    draw = np.random.default_rng(3)
    ours, theirs = draw.normal(0.0, 1.0, (3, 5)), draw.normal(0.6, 2.0, (3, 9))
    expected = stats.ttest_ind(ours, theirs, axis=1, equal_var=False).pvalue
    assert _welch_probabilities(ours, theirs) == pytest.approx(expected)
    assert _welch_probabilities(theirs, ours) == pytest.approx(expected)


def test_one_block_has_no_variance_and_equal_numbers_no_difference():
    from scipy import stats

    one, four = np.array([[0.5]]), np.array([[0.0, 1.0, 2.0, 5.0]])
    t, degrees_of_freedom = (0.5 - 2.0) / (four.std(ddof=1) / 2.0), 3.0
    assert _welch_probabilities(one, four) == pytest.approx([2.0 * stats.t.cdf(t, degrees_of_freedom)])
    assert _welch_probabilities(one, one + 1.0) == [1.0]


def test_states_behind_one_that_does_not_change_are_compared_as_well():
    from scipy import stats

    ours, theirs = np.array([[2.0, 2.0], [0.0, 1.0]]), np.array([[2.0, 2.0], [5.0, 6.0]])
    assert _welch_probabilities(ours, theirs) == pytest.approx(
        [1.0, stats.ttest_ind(ours[1], theirs[1], equal_var=False).pvalue]
    )


def test_what_is_simulated_in_the_place_of_measurements_was_not_measured(measured):
    times = 0.5 * np.arange(30.0)
    made_up = make_simulator(measured, times, 1e-6, 60).measurements
    assert made_up.bounds.tolist() == [[0, 30]]
    assert made_up.times is times
    assert not made_up.measured.any()
    assert (made_up.weights == 1.0).all()
    assert made_up.smoothed.min(axis=1) == pytest.approx(measured.smoothed.min(axis=1))
    assert made_up.smoothed.max(axis=1) == pytest.approx(measured.smoothed.max(axis=1))


def test_the_level_is_shared_by_means_and_variances_of_all_states(monkeypatch, measured):
    """0.01 over six comparisons."""
    for probability, is_kept in ((0.0018, True), (0.0015, False)):
        monkeypatch.setattr(long_run, "_welch_probabilities", lambda *_, level=probability: [1.0, level, 0.5])
        seen = looked(measured, TRUTH)
        assert (seen.is_kept, seen.probability) == (is_kept, probability)
