"""Verdicts: every grade can be reached, and the sentence says why."""

import math
from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.model.inference.residuals import check
from atoll_coordinator.model.inference.verdict import Evidence, judge
from atoll_coordinator.model.refinement import Chaos, Constant, Prediction
from atoll_core.data.dataset import FloatArray

KNOWN = (Constant(3.0, 2.98, 0.02, (2.94, 3.02)), Constant(1.0, 1.01, 0.02, (0.97, 1.05)))


def noise(sd: float, seed: int = 0) -> tuple[FloatArray, ...]:
    draw = np.random.default_rng(seed)
    return tuple(draw.normal(0.0, sd, 100) for _ in range(4))


def waves(sd: float) -> tuple[FloatArray, ...]:
    return tuple(sd * np.sqrt(2.0) * np.sin(np.linspace(0.0, 12.0, 100) + start) for start in range(4))


NOISY = Evidence(0.3, 0.2, 0.9, noise(0.1), 3.0, noise=0.1, standard_deviation=2.0, constants=KNOWN, alternative=9.0)
SHARP = (Constant(3.0, 3.0, 2e-9, (3.0, 3.0)), Constant(1.0, 1.0, 2e-9, (1.0, 1.0)))
CLEAN = Evidence(1e-12, 1e-9, 1.0, waves(1e-9), 3.0, noise=0.0, standard_deviation=2.0, constants=SHARP)


def test_a_simulation_without_noise_and_without_error_is_exact() -> None:
    grade, reason = judge(CLEAN)
    assert grade == "exact"
    assert "misses the measurements by 5e-10 of their deviation" in reason


def test_a_table_that_a_solver_computed_is_said_to_be_its() -> None:
    grade, reason = judge(replace(CLEAN, solver="solve_ivp, RK45, rtol=0.001, atol=1e-06"))
    assert grade == "exact"
    assert reason.startswith(
        "Without noise: solve_ivp, RK45, rtol=0.001, atol=1e-06, gives these rows of the equations to "
    )


@pytest.mark.parametrize("part", ["constants", "unit_coefficients"])
def test_a_term_that_may_follow_errors_of_a_solver_is_not_exact(part: str) -> None:
    crumb = Constant(4.6e-07, 4.6e-07, 4.6e-08, (3.6e-07, 5.6e-07))
    grade, reason = judge(replace(CLEAN, **{part: (*SHARP, crumb)}))
    assert grade == "good"
    assert "the constant 4.6e-07 is known to 10 % only" in reason


def test_an_equation_that_others_agree_with_on_the_curve_alone_is_not_exact() -> None:
    """Odds of one in two hundred are what an exact verdict may be wrong by."""
    where = Prediction(12, 12, 1.0, 0.1, None, {"x": 1.0, "y": 2.0}, is_disputed=True)
    assert judge(replace(CLEAN, rivals=0.0049, prediction=where))[0] == "exact"
    grade, reason = judge(replace(CLEAN, rivals=0.0052, rivals_agree=True, prediction=where))
    assert grade == "good"
    assert "cannot be told from other equations, which agree along what was measured" in reason
    assert reason.endswith("(0.52 % of the odds): measure from x = 1, y = 2 to decide.")
    grade, reason = judge(replace(CLEAN, rivals=1.0, rivals_agree=True, alternative=0.0, prediction=where))
    assert grade == "doubtful"
    assert reason == (
        "Another equation describes the data about as well (0 nats apart): measure from x = 1, y = 2 to decide."
    )


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
    grade, reason = judge(replace(NOISY, prediction=replace(sure, followed=9, unfinished=3)))
    assert grade == "doubtful"
    assert "From 3 of 12 other initial states within the measured range its simulation takes more steps" in reason
    assert "runs away" not in reason


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


def drawn(seed: int, count: int, sd: float = 0.1, correlation: float = 0.0) -> tuple[FloatArray, ...]:
    """Return one trajectory of noise, neighbours of which go together."""
    draws = np.random.default_rng(seed).normal(0.0, sd, count + 1)
    return (draws[1:] + correlation * draws[:-1],)


@pytest.mark.parametrize(
    ("residuals", "what"),
    [
        (drawn(5, 12, 0.145), "large by chance"),
        (drawn(0, 40_000, 0.112), "large, but not by much"),
        (drawn(1, 30, 0.1, 0.3), "patterned by chance"),
        (drawn(0, 40_000, 0.1, 0.05), "patterned, but not by much"),
    ],
)
def test_what_may_be_chance_or_is_small_is_no_objection(residuals: tuple[FloatArray, ...], what: str) -> None:
    checked = check(residuals, 0.1, 3.0, None, is_robust=False)
    assert {
        "large by chance": checked.ratio > 1.25 and checked.too_large > 0.01,
        "large, but not by much": 1.0 < checked.ratio < 1.25 and checked.too_large < 0.01,
        "patterned by chance": checked.correlation > 0.1 and checked.patterned > 0.01,
        "patterned, but not by much": 0.0 < checked.correlation < 0.1 and checked.patterned < 0.01,
    }[what]
    assert judge(replace(NOISY, residuals=residuals))[0] == "good"


def test_shares_are_of_the_deviation_of_what_was_measured() -> None:
    assert "misses the measurements by 8.5 % of their deviation" in judge(replace(NOISY, residuals=noise(0.17)))[1]
    clean = replace(NOISY, noise=1.9e-5, residuals=noise(0.17))
    assert "There is no noise, but the simulation misses the measurements by 8.5 %" in judge(clean)[1]
    assert "What the simulation leaves, 5 % of the deviation, is like the noise, 5 %" in judge(NOISY)[1]


def test_a_small_pattern_may_stay() -> None:
    assert judge(replace(CLEAN, residuals=waves(1e-4)))[0] == "good"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"alternative": 1.24}, "1.2 nats apart"),
        ({"alternative": -1.24}, "1.2 nats shorter"),
        ({"residuals": waves(0.1)}, "follows a pattern"),
        ({"residuals": noise(0.17)}, "times the noise"),
        ({"held_out_r2": 0.3}, "held-out trajectories are simulated with R2 0.3 only"),
        ({"held_out_r2": 0.3, "is_cross_validated": True}, "left out one at a time are simulated with R2 0.3 only"),
        ({"constants": (KNOWN[0], replace(KNOWN[1], identifiable=False))}, "1 of 2 constants are not determined"),
        ({"constants": (replace(KNOWN[1], identifiable=False),)}, "Its constant is not determined"),
        ({"constants": (replace(KNOWN[1], value=0.5, is_at_bound=True),)}, "have the constant 0.5 beyond its bound"),
        ({"residuals": waves(0.1), "noise": 0.0}, "there is no noise, but the simulation misses"),
        ({"fails_beyond": 500}, "it describes pieces of 500 rows and not whole trajectories"),
        ({"passes_pole": True}, "its simulation passes a pole"),
        ({"distinct_rows": 4}, "the rows repeat 4 measurements"),
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
        (Evidence(0.8, 0.1, 0.02), "no model", "nothing much better than a constant was found"),
        (Evidence(0.8, 0.1, 0.02, is_known=True), "no model", "it is not much better than a constant"),
        (Evidence(), "no model", "not finite"),
    ],
)
def test_without_trajectories_the_target_decides(evidence: Evidence, grade: str, said: str) -> None:
    verdict, reason = judge(evidence)
    assert verdict == grade
    assert said.lower() in reason.lower()
    assert reason[0].isupper()
    assert reason.endswith(".")


QUIET = replace(CLEAN, noise=1.5e-5, residuals=noise(2e-5))
"""Noise of 0.75e-5 of the deviation, which is 2, and what is left is 1e-5 of it."""


def test_what_counts_as_clean_and_exact_is_relative_to_the_deviation() -> None:
    assert judge(QUIET)[0] == "exact"
    assert judge(replace(QUIET, residuals=noise(4e-5)))[0] == "good"
    assert judge(replace(QUIET, noise=2.5e-5))[0] == "good"


def test_a_constant_is_known_to_a_share_of_its_estimate() -> None:
    rounded = Constant(3.0, 1e-6, 1e-8, (0.0, 3.0))
    assert "the constant 3 is known to 1 % only" in judge(replace(CLEAN, constants=(rounded,)))[1]
    unfitted = Constant(3.0, None, 0.3, (2.0, 4.0))
    assert "the constant 3 is known to 10 % only" in judge(replace(CLEAN, constants=(unfitted,)))[1]
    wide = Constant(3.0, 2.0, 3.0, (-3.0, 7.0))
    assert "the constant 3 is known to 150 % only" in judge(replace(CLEAN, constants=(wide,)))[1]
    assert judge(replace(CLEAN, constants=()))[0] == "exact"


def test_noise_takes_its_part_of_what_held_out_trajectories_can_be_foretold() -> None:
    loud = replace(NOISY, noise=1.0, residuals=noise(1.0))
    assert judge(replace(loud, held_out_r2=0.7))[0] == "good"
    assert judge(replace(loud, held_out_r2=0.6))[0] == "doubtful"


def test_errors_that_add_up_along_trajectories_may_be_larger_but_not_large() -> None:
    grade, reason = judge(replace(CLEAN, are_errors_summed=True, residuals=waves(0.02)))
    assert grade == "good"
    assert "misses the measurements by 1 % of their deviation, by errors that add up" in reason
    assert judge(replace(CLEAN, residuals=waves(0.02)))[0] == "doubtful"
    assert judge(replace(CLEAN, are_errors_summed=True, residuals=waves(0.8)))[0] == "doubtful"


@pytest.mark.parametrize(
    ("chaos", "grade", "said"),
    [
        (Chaos(2.0, True, 0.3), "good", "chaotic: errors grow e-fold in 2"),
        (Chaos(2.0, False, 0.001), "doubtful", "means or variances of a long simulation are not those measured"),
        (Chaos(2.0, False, None), "doubtful", "a long simulation runs away"),
        (Chaos(2.0, False, None, is_unfinished=True), "doubtful", "a long simulation takes more steps"),
    ],
)
def test_a_chaotic_model_stays_with_what_was_measured_or_is_doubtful(chaos: Chaos, grade: str, said: str) -> None:
    verdict, reason = judge(replace(NOISY, chaos=chaos))
    assert verdict == grade
    assert said.lower() in reason.lower()


def test_without_trajectories_nothing_uncertain_or_unsimulated_is_exact() -> None:
    assert judge(Evidence(3e-14, 0.01, 1.0))[0] == "good"
    grade, reason = judge(Evidence(3e-14, 0.0, 1.0, is_unsimulated=True))
    assert grade == "doubtful"
    assert "not simulated along the trajectories" in reason


def test_errors_of_the_target_explain_as_much_error_and_no_more() -> None:
    assert "that of the target itself" in judge(Evidence(0.019, 0.01, 0.99))[1]
    assert "it explains the target" in judge(Evidence(0.03, 0.01, 0.99))[1].lower()
    _, reason = judge(Evidence(0.4, 0.25, 0.8))
    assert "R2" not in reason  # the error is that of the target
    _, reason = judge(Evidence(0.4, 0.1, 0.8))
    assert "R2 0.8 only" in reason


def test_a_constant_is_known_by_its_size_whatever_its_sign() -> None:
    below = Constant(-3.0, -3.0, 2e-9, (-3.0, -3.0))
    assert judge(replace(CLEAN, constants=(below,)))[0] == "exact"
    reason = judge(replace(CLEAN, constants=(replace(below, std_error=0.3),)))[1]
    assert "the constant -3 is known to 10 % only" in reason


@pytest.mark.parametrize("estimate", [0.0, 1e-12, -1e-12])
def test_a_constant_far_within_its_error_is_said_to_be_no_more_than_zero(estimate: float) -> None:
    """A share of an estimate of zero had 294 digits."""
    crumb = Constant(estimate, estimate, 1e-9, (-2e-9, 2e-9))
    grade, reason = judge(replace(CLEAN, constants=(crumb,)))
    assert grade == "good"
    assert f"the constant {estimate:.3g} cannot be told from 0: its term may follow errors of the data" in reason


def test_a_constant_without_a_standard_error_is_no_doubt() -> None:
    assert judge(replace(CLEAN, constants=(Constant(0.5, 0.5),)))[0] == "exact"


@pytest.mark.parametrize(("rows", "grade"), [(4, "doubtful"), (5, "good"), (100, "good")])
def test_five_rows_that_differ_are_enough(rows: int, grade: str) -> None:
    assert judge(replace(NOISY, distinct_rows=rows))[0] == grade


def test_what_is_followed_nowhere_is_not_blamed_on_rivals() -> None:
    reason = judge(replace(NOISY, prediction=Prediction(12, 0, 0.0, math.inf)))[1]
    assert reason == "From 12 of 12 other initial states within the measured range it runs away."


def test_the_share_that_follows_a_pattern_is_at_most_all_of_it() -> None:
    assert "bout 99 % of what it leaves follows a pattern" in judge(replace(NOISY, residuals=waves(0.1)))[1]
    many = replace(NOISY, residuals=waves(0.1), parameters=20.0)
    assert check(many.residuals, many.noise, many.parameters).correlation > 1.01
    assert "bout 100 % of what it leaves follows a pattern" in judge(many)[1]


@pytest.mark.parametrize(
    ("r2", "text"), [(0.99996, "R2 0.9999."), (0.98765, "R2 0.9876."), (-math.inf, "R2 -inf only")]
)
def test_what_is_not_quite_explained_is_never_rounded_up(r2: float, text: str) -> None:
    assert text in judge(replace(NOISY, held_out_r2=r2))[1]


def test_what_is_not_known_of_an_equation_is_no_doubt() -> None:
    assert judge(Evidence(3e-14))[0] == "exact"
    assert judge(Evidence(residuals=noise(1e-9)))[0] == "exact"
    reason = judge(Evidence(residuals=noise(0.02)))[1]
    assert reason == "There is no noise, but the simulation misses the measurements by 2 % of their deviation."


def test_a_wild_measurement_decides_unless_there_are_outliers() -> None:
    first, *others = noise(0.1)
    wild = replace(NOISY, residuals=(np.append(first, 10.0), *others))
    assert judge(wild)[0] == "doubtful"
    assert judge(replace(wild, has_outliers=True))[0] == "good"


def test_what_is_too_small_to_be_looked_at_is_not_said_to_be_like_the_noise() -> None:
    grade, reason = judge(replace(QUIET, noise=2.5e-5, residuals=waves(2e-5)))
    assert grade == "good"
    assert reason == "The simulation misses the measurements by 1e-05 of their deviation."


def test_nats_between_equations_have_no_sign() -> None:
    assert "(0 nats apart)" in judge(replace(NOISY, alternative=0.0))[1]
    assert "(0.5 nats apart)" in judge(replace(NOISY, alternative=0.5))[1]
    assert "(0.5 nats shorter)" in judge(replace(NOISY, alternative=-0.5))[1]
