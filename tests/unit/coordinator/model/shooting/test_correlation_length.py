"""Systems that lack equations: other states are inputs as smoothed, and errors go together over half a span."""

from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.model.inference.standard_errors import estimate_errors
from atoll_coordinator.model.shooting.measurements import measurements_of
from tests.unit.coordinator.model.shooting.made import LOTKA, LOTKA_TEXT, compare, recording

TIMES = 0.1 * np.arange(60.0)
SPAN = 16


@pytest.fixture(scope="module")
def made():
    its = recording(LOTKA, [[0.4, 1.5], [1.5, 0.3], [0.2, 0.4]], TIMES, 0.02, seed=3)
    return replace(its, smoothing=tuple(replace(each, span=SPAN) for each in its.smoothing))


def test_a_whole_system_has_none(made):
    assert measurements_of(made, range(2)).correlation_length == 1.0


def test_it_is_half_a_span_where_a_state_has_no_equation(made):
    assert measurements_of(made, [0]).correlation_length == SPAN / 2


def test_interpolated_states_are_taken_as_known(made):
    clean = replace(made, smoothing=tuple(replace(each, span=None) for each in made.smoothing))
    assert measurements_of(clean, [0]).correlation_length == 1.0


def test_it_makes_evidence_weaker_and_errors_larger(made):
    its = measurements_of(made, [0])
    weak, strong = (compare(LOTKA, replace(its, correlation_length=value)) for value in (SPAN / 2, 1.0))
    program = LOTKA.parsed(LOTKA_TEXT[0])
    weakly, strongly = weak.fit_model([program]), strong.fit_model([program])
    assert weakly.misfit == pytest.approx(strongly.misfit / (SPAN / 2))
    assert weak.constant_nats < strong.constant_nats
    ratios = np.diag(estimate_errors(weak, weakly).covariance) / np.diag(estimate_errors(strong, strongly).covariance)
    assert np.all(ratios > SPAN / 2)
