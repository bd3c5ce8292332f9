"""Initial states eliminated from the normal equations of a fit."""

from types import SimpleNamespace

import numpy as np

from atoll_coordinator.model.shooting.trajectory_fit import TrajectoryFit


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
    reduced = TrajectoryFit.reduced.fget(blocks)
    assert np.abs(reduced - left.T @ left).max() < 0.5 * np.abs(left.T @ left).max()
    assert (np.linalg.eigvalsh(reduced) > 0.0).all()
