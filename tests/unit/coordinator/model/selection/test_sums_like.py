"""Sums that say about what the best system does: tried where that leaves more than noise."""

import pytest

from atoll_coordinator.model.selection import stages
from atoll_core.config import JobConfig, SpaceConfig
from tests.unit.coordinator.model.selection.begun import looked_again, selected
from tests.unit.coordinator.model.shooting.made import Known

SATURATED = Known(("h",), lambda _, z: [1.5 / (1.0 + z[0] ** 2) - 0.6 * z[0]])
DECAY = Known(("h",), lambda _, z: [0.5 - z[0]])


@pytest.mark.parametrize("noise", [0.0, 0.0005])
def test_a_law_takes_the_place_of_what_is_about_the_same(noise):
    selection = selected(SATURATED, "1.4 - 1.5*h + 0.3*h*h - 0.05*h*h*h", noise)
    found = looked_again("sums like the equations", selection)
    text = SATURATED.text(found.model.programs[0])
    assert "/(" in text
    assert "h**2" in text
    assert found.model.nats < selection.model.nats - 20.0
    if not noise:
        assert found.comparison.score.is_exact(found.model)


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_where_nothing_is_left_none_are_tried(noise, monkeypatch):
    monkeypatch.setattr(stages, "propose_like", lambda *_: pytest.fail("there is nothing to explain"))
    selection = selected(DECAY, "0.4 - 0.9*h", noise)
    assert looked_again("sums like the equations", selection) is selection


def test_no_sum_is_larger_than_the_user_allows():
    config = JobConfig(space=SpaceConfig(max_size=7))
    selection = selected(SATURATED, "1.4 - 0.9*h", 0.0005, config)
    found = looked_again("sums like the equations", selection)
    assert len(found.model.programs[0]) <= 7
