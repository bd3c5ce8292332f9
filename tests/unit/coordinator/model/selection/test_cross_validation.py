"""Trajectories left out, one at a time."""

from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.selection.cross_validation import FOLDS, Validation, squared_errors
from atoll_coordinator.model.shooting.measurements import measurements_of
from atoll_coordinator.settings import SETTINGS
from tests.unit.coordinator.model.shooting.made import DECAY, SWING, compare, measurements, recording

TIMES = 0.1 * np.arange(30.0)
STARTS = ([1.0, 2.0], [0.5, -1.0], [2.0, 0.3], [-1.0, 1.0])
NOISE = 0.05


def swinging(starts=STARTS, **options):
    return compare(SWING, measurements(SWING, starts, TIMES, noise=NOISE, seed=120), 1e-5, **options)


def model(comparison, *texts):
    model = comparison.fit_model([SWING.parsed(text) for text in texts])
    assert model is not None
    return model


@pytest.mark.parametrize(("count", "possible"), [(1, False), (2, False), (3, True), (4, True)])
def test_it_takes_three_trajectories(count, possible):
    assert Validation(swinging(STARTS[:count])).is_possible is possible


def test_pieces_of_one_trajectory_stand_and_fall_together():
    rows = measurements_of(recording(SWING, STARTS[:2], TIMES, NOISE), [0, 1], piece=10)
    assert len(rows.bounds) == 6
    assert not Validation(compare(SWING, rows)).is_possible


def test_the_truth_foretells_and_less_does_not():
    rows = swinging()
    good = Validation(rows).of(model(rows, "y", "-1.9*x - 0.2*y"))
    assert all(0.9 < r2 < 1.0 for r2 in good)
    poor = Validation(rows).of(model(rows, "y", "-1.9*x"))
    assert min(poor) < min(good)


def test_it_is_the_error_of_fits_to_the_others():
    """x' = -a x, by hand: the rate from three trajectories, the start of the fourth alone."""
    comparison = compare(DECAY, measurements(DECAY, ([3.0], [2.0], [-1.0], [-2.0]), TIMES, noise=NOISE, seed=121), 1e-8)
    model = comparison.fit_model([DECAY.parsed("-0.4*x")])
    rows = comparison.estimator.measurements
    squares, total = 0.0, 0.0
    for left_out in range(4):
        others = compare(DECAY, rows.part({0, 1, 2, 3} - {left_out}), 1e-8).fit_model([DECAY.parsed("-0.4*x")])
        decay = np.exp(-abs(others.fit.system.values[0]) * TIMES)
        values = rows.part({left_out}).measured[0]
        squares += float(np.sum((values - decay * (decay @ values) / (decay @ decay)) ** 2))
        total += 30.0 * float(np.var(values))
    assert Validation(comparison).of(model) == pytest.approx([1.0 - squares / total], rel=1e-6)


def test_many_trajectories_are_left_out_several_at_a_time(monkeypatch):
    starts = [[1.0 + 0.2 * index, 0.0] for index in range(25)]
    comparison = compare(SWING, measurements(SWING, starts, TIMES[:8], noise=NOISE, seed=122), 1e-4)
    seen = []
    validation = Validation(comparison)

    def left(fitting, fold):
        seen.append(fold.left_out)
        return squared_errors(fitting, fold)

    monkeypatch.setattr(FOLDS, "compute", left)
    validation.of(model(comparison, "y", "-1.9*x - 0.2*y"))
    assert len(seen) == SETTINGS.effort.beam
    assert sorted(owner for fold in seen for owner in fold) == list(range(25))


def test_what_cannot_be_simulated_is_not_predicted():
    rows = swinging()
    fitted = model(rows, "y", "-1.9*x - 0.2*y")
    wild = replace(fitted, programs=(SWING.parsed("exp(9.0*x*x)"), fitted.programs[1]))
    assert Validation(rows).of(wild) == (-np.inf, -np.inf)


@pytest.mark.parametrize("fold", [0, 2])
def test_nothing_is_foretold_after_the_time_is_over(monkeypatch, fold):
    rows, now, seen = swinging(), [0.0], []
    fitted = model(rows, "y", "-1.9*x - 0.2*y")
    monkeypatch.setattr(rows.estimator, "deadline", Deadline(1.0, lambda: now[0]))
    validation = Validation(rows)

    def left(fitting, fitted_fold):
        made = squared_errors(fitting, fitted_fold)
        seen.append(made)
        now[0] = 2.0 if len(seen) == fold else now[0]
        return made

    monkeypatch.setattr(FOLDS, "compute", left)
    now[0] = 0.0 if fold else 2.0
    assert validation.of(fitted) is None
    assert len([made for made in seen if np.isfinite(made).all()]) == fold


def test_missing_values_do_not_count():
    whole = recording(SWING, STARTS, TIMES, NOISE, seed=120)
    whole.trajectories[2].measured[0, 4:20] = np.nan
    comparison = compare(SWING, measurements_of(whole, [0, 1]), 1e-5)
    fitted = Validation(comparison).of(model(comparison, "y", "-1.9*x - 0.2*y"))
    assert all(0.8 < r2 < 1.0 for r2 in fitted)
