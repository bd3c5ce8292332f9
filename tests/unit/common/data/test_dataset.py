"""What is told of a target."""

import numpy as np

from atoll_core.data.dataset import EXACT_ERROR, Target


def target(uncertainty: float, standard_deviation: float = 1.0) -> Target:
    return Target("x", "dx/dt", np.zeros(3), uncertainty, standard_deviation)


def test_convergence_follows_the_uncertainty_unless_the_job_has_a_target_error():
    assert target(0.0).convergence_threshold() == EXACT_ERROR
    assert target(0.05).convergence_threshold() == 0.1
    assert target(0.05).convergence_threshold(1e-4) == 1e-4


def test_the_error_of_convergence_has_the_unit_of_the_values():
    assert target(0.05, 20.0).convergence_error() == 2.0
    assert target(0.05, 20.0).convergence_error(0.5) == 10.0
