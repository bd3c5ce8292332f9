"""How fast errors grow: exact for a linear system, near the known exponent for Lorenz's."""

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.shooting.error_growth import growth_rate
from atoll_coordinator.model.shooting.measurements import measurements_of
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.model.shooting.system import system_of
from atoll_core.config import PRESETS
from atoll_core.expression.text.parsing import from_infix
from tests.unit.coordinator.model.shooting.made import SWING, table
from tests.unit.coordinator.model.sparse.lorenz import NAMES, prepared


def test_errors_of_a_damped_swing_shrink():
    recording = prepare(table(SWING, ([1.0, 2.0],), 0.1 * np.arange(200.0), 0.01, 1), PRESETS["default"]).recording
    measurements = measurements_of(recording, [0, 1])
    system = system_of([from_infix(text, ("x", "y")) for text in ("y", "-2*x - 0.3*y")], ("x", "y"), ("x", "y"))
    fit = MultipleShooting(measurements, 1e-6).fit(system.with_fixed_constants(), None, 0)
    assert growth_rate(fit) == pytest.approx(-0.15, abs=0.05)


def test_errors_of_lorenz_grow_e_fold_in_about_one_unit_of_time():
    measurements = measurements_of(prepared(1000, 0.0).recording, [0, 1, 2], piece=250)
    texts = ("10*(y - x)", "28*x - x*z - y", "x*y - 2.6666666666666665*z")
    system = system_of([from_infix(text, NAMES) for text in texts], NAMES, NAMES)
    fit = MultipleShooting(measurements, 1e-6).fit(system.with_fixed_constants(), None, 0)
    assert growth_rate(fit) == pytest.approx(1.0, abs=0.5)
