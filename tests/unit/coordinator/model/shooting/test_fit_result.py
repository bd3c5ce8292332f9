"""Initial states eliminated from normal equations; the growth of errors, exact for a linear system, near the known
exponent for Lorenz's."""

from types import SimpleNamespace

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.shooting.fit_result import TrajectoryFit, growth_rate
from atoll_coordinator.model.shooting.measurements import measurements_of
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.model.shooting.system import system_of
from atoll_core.config import PRESETS
from atoll_core.expression.text.parsing import from_infix
from tests.unit.coordinator.model.shooting.made import SWING, table
from tests.unit.coordinator.model.sparse.lorenz import NAMES, prepared


def test_initial_states_that_are_forgotten_leave_the_matrix_positive():
    generator = np.random.default_rng(0)
    starts = generator.standard_normal((50, 4))
    starts[:, 3] = starts[:, 2] + 1e-7 * generator.standard_normal(50)
    constants = starts @ generator.standard_normal((4, 3)) + 1e-5 * generator.standard_normal((50, 3))
    basis = np.linalg.qr(starts)[0]
    left = constants - basis @ (basis.T @ constants)
    blocks = SimpleNamespace(
        normal=constants.T @ constants, coupling=(constants.T @ starts)[None], own=(starts.T @ starts)[None]
    )
    reduced = TrajectoryFit.reduced.fget(SimpleNamespace(blocks=blocks))
    assert np.abs(reduced - left.T @ left).max() < 0.5 * np.abs(left.T @ left).max()
    assert (np.linalg.eigvalsh(reduced) > 0.0).all()


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
