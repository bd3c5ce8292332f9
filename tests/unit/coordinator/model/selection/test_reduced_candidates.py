"""Candidates that are too long to be compared, less one of their parts: the law may be among these."""

from dataclasses import replace

import pytest

from atoll_core.config import JobConfig
from atoll_core.expression.text.parsing import from_infix
from tests.unit.coordinator.model.selection.begun import looked_again, selected
from tests.unit.coordinator.model.shooting.made import Known

POWERS = Known(("h",), lambda _, z: [0.8 * abs(z[0]) ** 0.75 - 1.5 * abs(z[0]) ** 3])
SHORT = "0.09 + 1.47*h*(0.576 - h*(0.117 + h))"


def parsed(text):
    return from_infix(text, ("h",))


def test_a_law_is_found_in_a_longer_candidate():
    """One short trajectory, of which a cubic leaves little more than the noise: four terms are not worth a fit."""
    selection = selected(POWERS, SHORT, 1e-5, JobConfig(), ([0.45],))
    law = selection.comparison.fit_model([parsed("0.8*h**0.75 - 1.5*h*h*h")])
    long = parsed("0.9*h**0.7 - 1.45*h**3.03 - 0.01*sin(h)")
    assert selection.comparison.score.length(long) > selection.comparison.score.length_limit(selection.model, 0)
    found = looked_again("candidates with one part removed", replace(selection, lists=[[long]]))
    assert found.model.nats == pytest.approx(law.nats, abs=1e-3)
    assert found.model.nats < selection.model.nats


def test_what_is_no_better_changes_nothing():
    selection = selected(POWERS, "0.8*h**0.75 - 1.5*h*h*h")
    lists = [[parsed("0.4 - 0.5*h*h + sin(h)*h**1.3 - cos(h*h)")]]
    selection = replace(selection, lists=lists)
    assert looked_again("candidates with one part removed", selection) is selection
