"""Where time is over before the search is, laws by regression that leave noise alone are shown."""

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.pipeline import OUT_OF_TIME, refine_all
from atoll_coordinator.model.selection import model_selection
from atoll_core.config import JobConfig, SpaceConfig
from atoll_core.expression.text.infix import to_infix
from tests.unit.coordinator.model.shooting.made import Known, pools, table
from tests.unit.coordinator.model.sparse.lorenz import monomials

PREY = Known(("x", "y"), lambda _, z: [z[0] - z[0] * z[1], z[0] * z[1] - 1.5 * z[1]])
CONFIG = JobConfig(space=SpaceConfig(operators=("+", "-", "*", "sin")))
WILD = {"x": ("0.7*x*sin(1.4 - y*y)",), "y": ("1.3*sin(x*y) - y*sin(y)",)}


def refined(monkeypatch, stage):
    """Return what is refined when time is over right after, or before, a stage of the selection."""
    seconds = [0.0]
    original = getattr(model_selection, stage)

    def late(*arguments):
        made = original(*arguments)
        seconds[0] = 70.0
        return made

    monkeypatch.setattr(model_selection, stage, late)
    prepared = prepare(table(PREY, ([1.0, 0.5], [2.5, 1.0]), 0.1 * np.arange(80.0), noise=0.02, seed=3), CONFIG)
    return refine_all(prepared, CONFIG, pools(prepared, **WILD), Deadline(100.0, lambda: seconds[0]))


@pytest.mark.parametrize("stage", ["fit_laws_in_short_pieces", "select_laws"])
def test_laws_are_shown_where_there_was_no_time_for_others(monkeypatch, stage):
    monkeypatch.setattr("atoll_coordinator.model.selection.shortcut.fit_laws_together", lambda *_: None)
    made = refined(monkeypatch, stage)
    assert OUT_OF_TIME in made.warnings
    shown = {name: monomials(to_infix(made.equations[name].program, PREY.names), PREY.names) for name in PREY.states}
    assert shown == {"x": {"x", "x*y"}, "y": {"y", "x*y"}}
    assert made.simulation is not None
