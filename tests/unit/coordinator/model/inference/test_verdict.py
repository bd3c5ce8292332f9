"""Verdicts: every grade can be reached, and the sentence says why."""

from dataclasses import replace

import numpy as np
import pytest

from atoll.data.dataset import FloatArray
from atoll_coordinator.model.inference.verdict import Evidence, judge
from atoll_coordinator.model.refinement import Constant, Prediction

KNOWN = (Constant(3.0, 2.98, 0.02, (2.94, 3.02)), Constant(1.0, 1.01, 0.02, (0.97, 1.05)))


def noise(sd: float, seed: int = 0) -> tuple[FloatArray, ...]:
    draw = np.random.default_rng(seed)
    return tuple(draw.normal(0.0, sd, 100) for _ in range(4))


def waves(sd: float) -> tuple[FloatArray, ...]:
    return tuple(sd * np.sqrt(2.0) * np.sin(np.linspace(0.0, 12.0, 100) + start) for start in range(4))


NOISY = Evidence(0.3, 0.2, 0.9, noise(0.1), 0, 3.0, noise=0.1, standard_deviation=2.0, constants=KNOWN, alternative=9.0)
SHARP = (Constant(3.0, 3.0, 2e-9, (3.0, 3.0)), Constant(1.0, 1.0, 2e-9, (1.0, 1.0)))
CLEAN = Evidence(1e-12, 1e-9, 1.0, waves(1e-9), 0, 3.0, noise=0.0, standard_deviation=2.0, constants=SHARP)


def test_a_simulation_without_noise_and_without_error_is_exact() -> None:
    grade, reason = judge(CLEAN)
    assert grade == "exact"
    assert "misses the measurements by 5e-10 of their deviation" in reason


@pytest.mark.parametrize("part", ["constants", "unit_coefficients"])
def test_a_term_that_may_follow_errors_of_a_solver_is_not_exact(part: str) -> None:
    crumb = Constant(4.6e-07, 4.6e-07, 4.6e-08, (3.6e-07, 5.6e-07))
    grade, reason = judge(replace(CLEAN, **{part: (*SHARP, crumb)}))
    assert grade == "good"
    assert "the constant 4.6e-07 is known to 10 % only" in reason


def test_a_factor_of_one_that_another_can_stand_for_is_no_doubt() -> None:
    loose = Constant(1.0, 1.0, np.inf, None, identifiable=False)
    assert judge(replace(CLEAN, unit_coefficients=(loose,)))[0] == "exact"


def test_what_is_good_is_foretold_elsewhere() -> None:
    sure = Prediction(12, 12, 0.99, 0.1, None, {"x": 1.0, "y": 2.0})
    grade, reason = judge(replace(NOISY, prediction=sure))
    assert grade == "good"
    assert "measure from" not in reason
    grade, reason = judge(replace(NOISY, prediction=replace(sure, reached=3.51)))
    assert grade == "good"
    assert "leads to 3.51, which was never measured: measure from x = 1, y = 2 to know" in reason
    grade, reason = judge(replace(NOISY, prediction=replace(sure, probability=0.7)))
    assert grade == "doubtful"
    assert "measure from x = 1, y = 2 to decide" in reason
    grade, reason = judge(replace(NOISY, prediction=replace(sure, followed=10)))
    assert grade == "doubtful"
    assert "From 2 of 12 other initial states within the measured range it runs away" in reason


def test_residuals_like_the_noise_are_good() -> None:
    grade, reason = judge(replace(NOISY, held_out_r2=0.995))
    assert grade == "good"
    assert "like the noise, 5 %" in reason
    assert "R2 0.995" in reason


def test_held_out_trajectories_are_told_from_those_left_out_in_turn() -> None:
    assert "held-out trajectories: R2 0.995" in judge(replace(NOISY, held_out_r2=0.995))[1]
    _, reason = judge(replace(NOISY, held_out_r2=0.995, is_cross_validated=True))
    assert "trajectories left out one at a time: R2 0.995" in reason
    assert "held" not in reason


def test_a_small_pattern_may_stay() -> None:
    assert judge(replace(CLEAN, residuals=waves(1e-4)))[0] == "good"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"alternative": 1.24}, "1.2 nats apart"),
        ({"alternative": -1.24}, "1.2 nats shorter"),
        ({"residuals": waves(0.1)}, "follows a pattern"),
        ({"residuals": noise(0.17)}, "times the noise"),
        ({"residuals": noise(0.1)[:3], "failed": 1}, "to the end of 1 of 4 trajectories"),
        ({"held_out_r2": 0.3}, "held-out trajectories are simulated with R2 0.3 only"),
        ({"held_out_r2": 0.3, "is_cross_validated": True}, "left out one at a time are simulated with R2 0.3 only"),
        ({"constants": (KNOWN[0], replace(KNOWN[1], identifiable=False))}, "1 of 2 constants are not determined"),
        ({"constants": (replace(KNOWN[1], identifiable=False),)}, "Its constant is not determined"),
        ({"constants": (replace(KNOWN[1], value=0.5, is_at_bound=True),)}, "have the constant 0.5 beyond its bound"),
        ({"residuals": waves(0.1), "noise": 0.0}, "there is no noise, but the simulation misses"),
    ],
)
def test_doubts_are_said(change: dict[str, object], said: str) -> None:
    grade, reason = judge(replace(NOISY, **change))
    assert grade == "doubtful"
    assert said.lower() in reason.lower()


def test_two_doubts_are_enough() -> None:
    _, reason = judge(replace(NOISY, residuals=waves(0.3), alternative=0.5))
    assert "times the noise" in reason
    assert "follows a pattern" in reason
    assert "another equation" not in reason


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"residuals": noise(1.9)}, "explains too little"),
        ({"residuals": (np.array([0.1, np.nan, 0.1]),)}, "explains too little"),
        ({"residuals": (), "failed": 4}, "4 of 4 trajectories"),
        ({"residuals": noise(0.1)[:2], "failed": 2}, "2 of 4 trajectories"),
    ],
)
def test_a_simulation_that_explains_little_or_does_not_end_is_no_model(change: dict[str, object], said: str) -> None:
    grade, reason = judge(replace(NOISY, **change))
    assert grade == "no model"
    assert said in reason


@pytest.mark.parametrize(
    ("evidence", "grade", "said"),
    [
        (Evidence(3e-14, 0.0, 1.0), "exact", "level of rounding"),
        (Evidence(1e-7, 1e-7, 1.0, convergence_threshold=2e-7), "exact", "level of rounding"),
        (Evidence(0.009, 0.008, 0.99, constants=KNOWN), "good", "that of the target itself"),
        (Evidence(0.05, 0.04, 0.99, constants=KNOWN), "doubtful", "uncertain by 4 %"),
        (Evidence(0.05, 0.0, 0.99, constants=KNOWN), "good", "R2 0.99; how much of the rest is noise"),
        (Evidence(0.05, 0.0), "good", "5 % of the target's deviation"),
        (Evidence(0.4, 0.0, 0.8), "doubtful", "R2 0.8 only"),
        (Evidence(0.4, 0.25, 0.7), "doubtful", "uncertain by 25 %"),
        (Evidence(0.05, 0.0, 0.99, alternative=0.1), "doubtful", "another equation"),
        (Evidence(0.8, 0.1, 0.02), "no model", "better than a constant"),
        (Evidence(0.8, 0.1, 0.02, is_known=True), "no model", "it is not much better than a constant"),
        (Evidence(), "no model", "not finite"),
    ],
)
def test_without_trajectories_the_target_decides(evidence: Evidence, grade: str, said: str) -> None:
    found, reason = judge(evidence)
    assert found == grade
    assert said.lower() in reason.lower()
    assert reason[0].isupper()
    assert reason.endswith(".")
