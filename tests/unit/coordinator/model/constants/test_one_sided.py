"""Intervals of constants on a bound: quantiles of a truncated normal distribution."""

import subprocess
import sys

import numpy as np
import pytest

from atoll_coordinator.model.constants.standard_errors import one_sided_interval_lengths


@pytest.mark.parametrize("slope", [0.0, 0.5, 20.0, 1e4])
def test_reaches_are_quantiles_of_a_truncated_normal(slope):
    from scipy import stats

    error, gradient = 0.5, np.array([0.0, -slope])
    reaches = one_sided_interval_lengths(np.diag([1.0, 4.0]), gradient, np.array([False, True]))
    beyond = slope * error
    expected = error * stats.truncnorm.ppf(0.95, beyond, np.inf, loc=-beyond)
    assert reaches == {1: pytest.approx(expected, rel=1e-6)}


@pytest.mark.slow
def test_what_takes_long_to_load_is_not_loaded_for_it():
    """scipy.stats takes longer than many a refinement."""
    code = (
        "import sys, numpy as np; "
        "from atoll_coordinator.model.constants.standard_errors import one_sided_interval_lengths as its; "
        "its(np.eye(1), None, np.array([True])); print('scipy.stats' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
