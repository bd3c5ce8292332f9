"""The cases of the seven systems: which are flagged as singular, and the truths in other units."""

import numpy as np
import pytest

from atoll_core.expression.evaluation import values_of
from atoll_core.expression.text.parsing import from_infix
from benchmarks.harness.systems import Sampled, trajectories
from benchmarks.paper.seven import SCALED_TRUTH, case, pendulum, scaled, singular


def test_a_well_sampled_run_is_not_flagged():
    assert case("bar_magnets", 0.1, 0).singular == frozenset()


def test_a_run_beside_a_singularity_is_flagged_in_the_variable_that_jumps():
    times = np.arange(100) * 0.1
    smooth = trajectories("bar_magnets", 0.1, 0)
    jumping = np.column_stack((np.sign(times - 5.03), np.zeros(100)))
    sampled = Sampled(("theta1", "theta2"), (*smooth.times, times), (*smooth.values, jumping))
    assert "theta1" in singular("bar_magnets", sampled)


def test_the_truth_in_other_units_is_the_derivative_there():
    plain, large = trajectories("lotka_volterra", 0.02, 0), scaled(0.02, 3)
    state = large.sampled.values[0]
    slopes = [values_of(from_infix(text, ("x", "y")), state.T) for text in SCALED_TRUTH.values()]
    x, y = plain.values[0].T
    assert np.allclose(slopes[0] / 1e-6, 3 * x - 2 * x * y - x * x)
    assert np.allclose(slopes[1] / 1e6, 2 * y - x * y - y * y)
    assert large.sampled.times[0][0] == 1900.0


def test_the_pendulum_is_sought_in_second_order():
    its = pendulum(0.1, 2)
    assert (its.order, its.sampled.names, list(its.truths)) == (2, ("theta",), ["theta"])


def test_an_unknown_system_is_refused(capsys):
    from benchmarks.paper.seven import main

    with pytest.raises(SystemExit) as ended:
        main(["--system", "no_such"])
    assert ended.value.code == 2
    assert "no_such" in capsys.readouterr().err
