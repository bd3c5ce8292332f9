"""Chaotic models are judged by what chaos allows: a right one keeps the measured averages, a wrong one does not."""

from dataclasses import replace

import numpy as np
import pytest

from atoll.expression.text.parsing import from_infix
from atoll_coordinator.model.inference.attractor import look_for_chaos
from atoll_coordinator.model.inference.verdict import Evidence, judge
from atoll_coordinator.model.refinement import Chaos
from atoll_coordinator.model.result.trust import chaos
from atoll_coordinator.model.shooting.measurements import measurements_of
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.model.shooting.system import system_of
from tests.unit.coordinator.model.sparse.lorenz import NAMES, prepared

TRUTH = ("10*(y - x)", "28*x - x*z - y", "x*y - 2.6666666666666665*z")


@pytest.fixture(scope="module")
def measured():
    return measurements_of(prepared(2000, 0.01, trajectories=2).recording, [0, 1, 2], piece=50)


def looked(measured, texts):
    system = system_of([from_infix(text, NAMES) for text in texts], NAMES, NAMES)
    fit = MultipleShooting(measured, 1e-6).fit(system.with_fixed_constants(), None, 0)
    return look_for_chaos(fit, 0.9, 1e-6)


def test_the_truth_stays_on_the_attractor(measured):
    found = looked(measured, TRUTH)
    assert found.is_kept
    assert found.lyapunov_time == pytest.approx(1.0 / 0.9)


@pytest.mark.parametrize("other", ["23*x - x*z - y", "35*x - x*z - y"])
def test_another_attractor_is_told_by_means_and_variances(measured, other):
    found = looked(measured, (TRUTH[0], other, TRUTH[2]))
    assert not found.is_kept
    assert found.probability < 1e-3


def test_the_way_to_the_attractor_does_not_count():
    its = measurements_of(prepared(500, 0.01, trajectories=8).recording, [0, 1, 2], piece=50)
    smoothed, count = its.smoothed.copy(), len(its.times) // 8
    for first in range(0, 8 * count, count):
        smoothed[:, first : first + count // 2] += 50.0
    assert looked(replace(its, smoothed=smoothed), TRUTH).is_kept


def test_a_simulation_that_runs_away_is_not_kept(measured):
    found = looked(measured, ("0.3*x", "0.3*y", "0.3*z"))
    assert (found.is_kept, found.probability) == (False, None)


def test_the_verdict_says_in_which_time_errors_grow_and_refuses_what_is_not_kept():
    residuals = [0.1 * np.random.default_rng(1).normal(size=400)]
    evidence = Evidence(residuals=residuals, noise=0.1, standard_deviation=1.0, chaos=Chaos(1.13, True, 0.4))
    grade, reason = judge(evidence)
    assert grade == "good"
    assert "errors grow e-fold in 1.1" in reason
    grade, reason = judge(replace(evidence, chaos=Chaos(1.13, False, 1e-5)))
    assert grade == "doubtful"
    assert "eans or variances" in reason
    assert "runs away" in judge(replace(evidence, chaos=Chaos(1.13, False, None)))[1]


def test_what_is_reported():
    assert chaos(None) is None
    assert chaos(Chaos(2.0, True, 0.5)) == {"lyapunov_time": 2.0, "is_kept": True, "probability": 0.5}
