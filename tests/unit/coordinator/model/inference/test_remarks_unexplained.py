"""What residuals of rates follow: a constant of each run, a wave in time, a hidden state; nothing for a right law."""

from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.data.recording import Recording, StateSmoothing, Trajectory
from atoll_coordinator.model.inference.remarks import warn_of_residual_pattern
from atoll_coordinator.model.refinement import Refined
from atoll_core.expression.text.parsing import from_infix

ERROR = 0.02


def recording(runs):
    """Return a recording of runs: times, states (S, R) and rates (S, R) of each."""
    parts = tuple(
        Trajectory(
            str(number), times, states, states, rates, np.zeros((0, len(times))), np.zeros((0, len(times))),
            rates=rates, rate_errors=np.full_like(rates, ERROR),
        )
        for number, (times, states, rates) in enumerate(runs)
    )  # fmt: skip
    names = tuple("xv"[: len(parts[0].measured)])
    smoothing = tuple(StateSmoothing(name, "loess", 0.01, 0.01, 9, 3) for name in names)
    return Recording(names, names, (), (), (), 1, 0.0, smoothing, parts)


def remarks(recorded, grade="doubtful", **equations):
    shown = {
        name: Refined(None, from_infix(text, recorded.state_symbols), 0.0, 0.0, grade=grade)
        for name, text in equations.items()
    }
    return "\n".join(warn_of_residual_pattern(recorded, shown))


def growth(rates, seed=0):
    draw = np.random.default_rng(seed)
    times = 0.1 * np.arange(60)
    curves = [(rate, 1.0 / (1.0 + 9.0 * np.exp(-rate * times))) for rate in rates]
    return recording(
        [(times, x[None], (r * x * (1.0 - x) + ERROR * draw.standard_normal(60))[None]) for r, x in curves]
    )


def test_runs_that_differ_in_a_constant_propose_constants_of_their_own():
    recorded = growth([0.5, 0.8, 1.1, 1.4])
    assert "add --per-trajectory" in remarks(recorded, x="0.95*x*(1 - x)")
    said = remarks(replace(recorded, hidden=("h",)), x="0.95*x*(1 - x)")
    assert "by run" in said
    assert "--per-trajectory" not in said  # hidden states exclude it


@pytest.mark.parametrize("seed", range(5))
def test_runs_of_one_law_propose_nothing(seed):
    recorded = growth([0.9, 0.9, 0.9, 0.9], seed)
    assert remarks(recorded, x="0.9*x*(1 - x)") == ""
    assert remarks(recorded, x="0.88*x*(1 - x)") == ""


def test_a_good_equation_is_left_alone():
    assert remarks(growth([0.5, 0.8, 1.1, 1.4]), grade="good", x="0.95*x*(1 - x)") == ""


def swing(forcing):
    times = 0.05 * np.arange(1200)
    x, v = np.cos(times) + 0.3 * np.cos(2.37 * times), -np.sin(times) - 0.711 * np.sin(2.37 * times)
    return recording([(times, np.stack([x, v]), np.stack([v, -x + forcing(times)]))])


def test_a_wave_in_time_that_states_do_not_follow_is_a_forcing():
    said = remarks(swing(lambda t: np.cos(2.0 * np.pi * t / 3.3)), x="v", v="-x")
    assert "a wave in time of period 3.28 " in said  # frequencies are a quarter of a wave of the whole time apart
    assert "of 'v' is" in said
    assert "add --inputs t" in said


def test_what_the_states_decide_is_neither_forced_nor_hidden():
    times = 0.05 * np.arange(1200)
    x, v = np.cos(times), -np.sin(times)
    recorded = recording([(times, np.stack([x, v]), np.stack([v, -x - 0.5 * x**3]))])
    assert remarks(recorded, x="v", v="-x") == ""


def test_one_state_that_swings_has_a_hidden_one():
    times = 0.05 * np.arange(1200)
    recorded = recording([(times, np.cos(times)[None], -np.sin(times)[None])])
    assert "add --order 2" in remarks(recorded, x="-0.01*x")
    assert "--order 2" not in remarks(replace(recorded, hidden=("v",)), x="-0.01*x")  # they exclude each other
