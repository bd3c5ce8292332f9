"""Verdicts: every grade can be reached, what was not tested is not passed, and the sentence says why."""

import math
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from atoll_coordinator.model.inference.checks import RULES, Evidence, judge, make_checks, with_objection
from atoll_coordinator.model.inference.residuals import residual_statistics
from atoll_coordinator.model.refinement import JobKind
from atoll_coordinator.result.equations import Check
from atoll_core.data.dataset import FloatArray
from tests.unit.coordinator.model.parts import chaos, constant, prediction

KNOWN = (constant(3.0, 2.98, 0.02, (2.94, 3.02)), constant(1.0, 1.01, 0.02, (0.97, 1.05)))
SURE = prediction(12, 12, 0.99, measure_from={"x": 1.0, "y": 2.0})


def noise(sd: float, seed: int = 0, rows: int = 100) -> tuple[FloatArray, ...]:
    draw = np.random.default_rng(seed)
    return tuple(draw.normal(0.0, sd, rows) for _ in range(4))


def waves(sd: float) -> tuple[FloatArray, ...]:
    return tuple(sd * np.sqrt(2.0) * np.sin(np.linspace(0.0, 12.0, 100) + start) for start in range(4))


NOISY = Evidence(
    error=0.3, target_uncertainty=0.2, target_r2=0.9, residuals=noise(0.1), parameters=3.0, noise=0.1,
    standard_deviation=2.0, constants=KNOWN, alternative=9.0, prediction=SURE, null_nats=500.0, piece=500,
    distinct_rows=400,
)  # fmt: skip
SHARP = (constant(3.0, 3.0, 2e-9, (3.0, 3.0)), constant(1.0, 1.0, 2e-9, (1.0, 1.0)))
CLEAN = Evidence(
    error=1e-12, target_uncertainty=1e-9, target_r2=1.0, residuals=waves(1e-9), parameters=3.0, noise=0.0,
    standard_deviation=2.0, constants=SHARP, prediction=SURE, null_nats=500.0, piece=500,
    distinct_rows=400,
)  # fmt: skip
TARGET = Evidence(
    kind="target", error=0.05, target_r2=0.99, predicted_r2=0.99, residuals=noise(0.1), parameters=3.0, noise=0.1,
    standard_deviation=2.0, constants=KNOWN, null_nats=500.0, distinct_rows=400,
)  # fmt: skip
EXACT_TARGET = replace(TARGET, error=3e-14, residuals=noise(1e-14), noise=0.0, constants=SHARP)


def outcomes(evidence: Evidence) -> dict[str, str]:
    return {check.name: check.outcome for check in judge(evidence).checks}


def test_every_check_applies_to_some_kind_of_job_and_every_kind_has_checks() -> None:
    """The steps of a process have checks of their own."""
    assert all(rule.kinds for rule in RULES)
    assert {kind for rule in RULES for kind in rule.kinds} == {*get_args(JobKind)} - {"process"}


@pytest.mark.parametrize("evidence", [NOISY, CLEAN, TARGET, EXACT_TARGET, replace(NOISY, kind="groups")])
def test_of_checks_that_apply_all_have_a_reason_and_passed(evidence: Evidence) -> None:
    for check in judge(evidence).checks:
        assert check.reason
        assert check.outcome == "passed" or (check.outcome, check.name) in {
            ("not applicable", name)
            for name in (
                "held-out trajectories",
                "long run",
                "alternative equations",
                "digits of constants",
                "inputs between rows",
            )
        }
    names = [check.name for check in make_checks(evidence)]
    assert names == [rule.name for rule in RULES if evidence.kind in rule.kinds and not rule.is_exactness]


def test_every_check_of_what_was_not_simulated_is_named() -> None:
    """None is left out in silence, and the sentence says once what is missing."""
    bare = replace(NOISY, residuals=(), null_nats=None, is_unsimulated=True, distinct_rows=None, alternative=None)
    verdict = judge(bare)
    made = {check.name: check.outcome for check in verdict.checks}
    assert set(made) == {rule.name for rule in RULES if "trajectories" in rule.kinds and not rule.is_exactness}
    assert made["simulation"] == "failed"
    others = ("residual size", "residual pattern", "poles", "no equation", "distinct rows", "alternative equations")
    assert {made[name] for name in (*others, "long run")} == {"not made"}
    assert verdict.reason == "It was not simulated along the trajectories, and fits the derivatives alone."


def test_residuals_of_integration_have_a_pattern_whatever_the_noise_is_taken_for() -> None:
    """Eight rows may be taken for noisy where there is no noise; what is left is as small as errors of integration."""
    tiny = replace(NOISY, residuals=waves(1e-9))
    assert outcomes(tiny)["residual pattern"] == "passed"
    assert outcomes(replace(NOISY, residuals=waves(0.05)))["residual pattern"] == "failed"


def test_a_small_misfit_without_noise_says_what_it_may_hide() -> None:
    verdict = judge(replace(CLEAN, residuals=waves(1e-3)))
    assert verdict.grade == "good"
    assert "would be taken for errors of integration" in verdict.reason


def test_the_long_run_of_a_driven_model_whose_errors_grow_was_not_tested() -> None:
    """Its own growth of errors is no excuse: a wrong model may have it, too."""
    driven = judge(replace(NOISY, fits_whole=None, predictable_rows=244))
    assert driven.grade == "doubtful"
    assert "no more than 244 rows can be predicted" in driven.reason
    assert outcomes(replace(NOISY, fits_whole=False, predictable_rows=244))["whole trajectories"] == "failed"


def test_a_target_without_a_value_on_a_row_says_so() -> None:
    verdict = judge(replace(TARGET, residuals=(), null_nats=None, distinct_rows=None, predicted_r2=None))
    assert verdict.grade == "doubtful"
    assert "no finite value on some rows" in verdict.reason
    assert "trajectories" not in verdict.reason


def test_residuals_like_the_noise_are_good() -> None:
    verdict = judge(replace(NOISY, held_out_r2=0.995))
    assert verdict.grade == "good"
    assert verdict.reason == (
        "The residuals (5 % of the standard deviation) agree with the noise (5 %) and show no pattern; held-out "
        "trajectories: R2 0.995."
    )


def test_a_simulation_without_noise_and_without_error_is_exact() -> None:
    verdict = judge(CLEAN)
    assert verdict.grade == "exact"
    assert verdict.reason == "Without noise, the residuals are 5e-10 of the standard deviation."
    assert {"precision", "other laws", "precision of constants"} <= set(outcomes(CLEAN))
    said = judge(replace(CLEAN, solver="solve_ivp, RK45, rtol=0.001, atol=1e-06")).reason
    assert said.startswith("Without noise: solve_ivp, RK45, rtol=0.001, atol=1e-06, gives these rows")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"alternative": 1.24}, "(Δ description length 1.2)"),
        ({"alternative": -1.24}, "(Δ description length -1.2)"),
        ({"residuals": waves(0.1)}, "of the residual variance follows a pattern"),
        ({"residuals": noise(0.17)}, "are 1.7 times the noise"),
        ({"held_out_r2": 0.3}, "held-out trajectories are simulated with R2 0.3 only"),
        ({"held_out_r2": 0.3, "is_cross_validated": True}, "left out one at a time are simulated with R2 0.3 only"),
        ({"constants": (KNOWN[0], KNOWN[1].replaced(identifiable=False))}, "1 of 2 constants are not determined"),
        ({"constants": (KNOWN[1].replaced(identifiable=False),)}, "Its constant is not determined"),
        ({"constants": (KNOWN[1].replaced(value=0.5, at_bound=True),)}, "have the constant 0.5 beyond its bound"),
        ({"residuals": waves(0.1), "noise": 0.0}, "there is no noise, but the residuals are 5 %"),
        ({"fits_whole": False}, "it describes pieces of 500 rows and not whole trajectories"),
        ({"passes_pole": True}, "its simulation passes a pole"),
        ({"distinct_rows": 4}, "the rows repeat 4 measurements"),
        ({"null_nats": 4.5}, "about as well without an equation"),
        ({"parameters": 400.0, "residuals": noise(0.01)}, "400 numbers were fitted to 400 rows"),
        ({"prediction": SURE.replaced(probability=0.7)}, "70 % of the odds agree): measure from x = 1, y = 2"),
        ({"prediction": SURE.replaced(followed=10)}, "From 2 of 12 other initial states within the measured range it"),
        ({"chaos": chaos(2.0, False, 0.001)}, "means or variances of a long simulation are not those measured"),
        ({"chaos": chaos(2.0, False, None)}, "a long simulation runs away"),
    ],
)
def test_a_check_that_fails_makes_an_equation_doubtful(change: dict[str, object], said: str) -> None:
    verdict = judge(replace(NOISY, **change))
    assert verdict.grade == "doubtful"
    assert said.lower() in verdict.reason.lower()
    assert "failed" in outcomes(replace(NOISY, **change)).values()


@pytest.mark.parametrize(
    ("change", "name", "said"),
    [
        ({"stopped": "the choice of the equations"}, "time", "limit of time stopped the choice of the equations"),
        ({"prediction": None, "unpredicted": "for a reason"}, "other initial states", "not tested: for a reason"),
        ({"fits_whole": None}, "whole trajectories", "only pieces of 500 rows were simulated"),
        ({"prediction": SURE.replaced(followed=9, unfinished=3)}, "other initial states", "takes more steps"),
        ({"chaos": chaos(2.0, False, None, is_unfinished=True)}, "long run", "a long simulation takes more steps"),
        (
            {"unknown_inputs": {"u": 0.3, "w 1": 0.2, "v": 0.01}, "held_inputs": ("h",)},
            "inputs between rows",
            "not known of 'u' and 'w 1' between rows makes 30 % of the variance of a rate: add --hold 'h,u,w 1'",
        ),
        ({"unfitted": 6}, "constants", "how well its 6 constants are determined is not known"),
        ({"unknown_inputs": {"u": math.nan}}, "inputs between rows", "too few rows to know 'u' between them"),
    ],
)
@pytest.mark.parametrize("evidence", [NOISY, CLEAN, replace(NOISY, kind="groups")], ids=["noisy", "clean", "groups"])
def test_a_check_that_was_not_made_has_not_passed(
    evidence: Evidence, change: dict[str, object], name: str, said: str
) -> None:
    changed = replace(evidence, **change)
    assert judge(changed).grade == "doubtful"
    assert said.lower() in judge(changed).reason.lower()
    assert outcomes(changed)[name] == "not made"


def test_a_test_that_would_have_seen_nothing_has_not_passed() -> None:
    """With so much noise in so few rows a departure of any size looks like noise."""
    blind = replace(NOISY, residuals=noise(1.4, rows=3), noise=1.4, parameters=2.0)
    (size,) = (check for check in judge(blind).checks if check.name == "residual size")
    assert size.outcome == "not made"
    assert size.power is not None
    assert size.power > 0.1
    assert judge(blind).grade == "doubtful"
    assert "The check of residual size cannot detect errors of the model below" in judge(blind).reason
    same_noise = replace(NOISY, residuals=noise(0.6), noise=0.6)
    assert judge(same_noise).grade == "good"


def test_the_power_of_tests_grows_with_rows() -> None:
    few, many = (residual_statistics(noise(0.1, rows=rows), 0.1, 3.0) for rows in (4, 100))
    assert few.seen_ratio > many.seen_ratio >= 1.25
    assert few.seen_correlation > many.seen_correlation >= 0.1
    assert math.isinf(residual_statistics(noise(0.1, rows=1), 0.1, 4.0).seen_ratio)


@pytest.mark.parametrize("level", [2e-4, 1e-3])
def test_small_residuals_are_tested_where_the_noise_is_known(level: float) -> None:
    """Seven times the noise and a pure pattern are a departure, also below a thousandth of the deviation."""
    quiet = replace(NOISY, noise=level / 7.0, residuals=waves(level))
    assert quiet.is_noisy
    verdict = judge(quiet)
    assert verdict.grade == "doubtful"
    assert "times the noise" in verdict.reason
    assert "follows a pattern" in verdict.reason
    assert judge(replace(CLEAN, residuals=waves(1e-4))).grade == "good"


def test_few_interpolated_rows_do_not_exclude_noise() -> None:
    few = replace(CLEAN, residuals=noise(0.02, rows=2), noise_estimate=0.008, parameters=2.0)
    assert outcomes(few)["residual size"] == "passed"
    assert outcomes(replace(few, residuals=noise(0.02)))["residual size"] == "failed"


@pytest.mark.parametrize("part", ["constants", "unit_coefficients"])
def test_a_term_that_may_follow_errors_of_a_solver_is_not_exact(part: str) -> None:
    crumb = constant(4.6e-07, 4.6e-07, 4.6e-08, (3.6e-07, 5.6e-07))
    verdict = judge(replace(CLEAN, **{part: (*SHARP, crumb)}))
    assert verdict.grade == "good"
    assert "the constant 4.6e-07 is known to 10 % only" in verdict.reason


def test_an_equation_that_others_agree_with_on_the_curve_alone_is_not_exact() -> None:
    """Odds of one in two hundred are what an exact verdict may be wrong by."""
    assert judge(replace(CLEAN, rivals=0.0049)).grade == "exact"
    unsure = judge(replace(CLEAN, rivals=0.0052, rivals_agree=True))
    assert unsure.grade == "good"
    assert unsure.reason.endswith("differ elsewhere (0.52 % of the odds): measure from x = 1, y = 2 to decide.")
    doubted = judge(replace(CLEAN, rivals=1.0, rivals_agree=True, alternative=0.0))
    assert doubted.grade == "doubtful"
    assert doubted.reason == (
        "Another equation describes the data about as well (Δ description length 0): "
        "measure from x = 1, y = 2 to decide."
    )


def test_what_is_good_may_lead_where_nothing_was_measured() -> None:
    verdict = judge(replace(NOISY, prediction=SURE.replaced(reached=3.51)))
    assert verdict.grade == "good"
    assert "leads to 3.51, which was never measured: measure from x = 1, y = 2 to know" in verdict.reason


def test_a_factor_of_one_that_another_can_stand_for_is_no_doubt() -> None:
    loose = constant(1.0, 1.0, np.inf, None, identifiable=False)
    assert judge(replace(CLEAN, unit_coefficients=(loose,))).grade == "exact"


def test_two_doubts_are_enough() -> None:
    reason = judge(replace(NOISY, residuals=waves(0.3), alternative=0.5)).reason
    assert "times the noise" in reason
    assert "follows a pattern" in reason
    assert "another equation" not in reason


@pytest.mark.parametrize("residuals", [noise(1.9), (np.array([0.1, np.nan, 0.1]),)])
def test_a_simulation_that_explains_little_or_does_not_end_is_no_model(residuals: tuple[FloatArray, ...]) -> None:
    verdict = judge(replace(NOISY, residuals=residuals))
    assert verdict.grade == "no model"
    assert "explains too little" in verdict.reason


@pytest.mark.parametrize(
    ("change", "grade", "said"),
    [
        ({}, "good", "rows left out one at a time are predicted with R2 0.99"),
        ({"target_uncertainty": 0.04}, "doubtful", "uncertain by 4 %"),
        ({"predicted_r2": 0.8}, "doubtful", "predicted with R2 0.8 only"),
        ({"predicted_r2": None}, "doubtful", "none can be left out"),
        ({"residuals": waves(0.1)}, "doubtful", "follows a pattern"),
        ({"null_nats": -3.0}, "doubtful", "about as well without an equation"),
        ({"distinct_rows": 3}, "doubtful", "the rows repeat 3 measurements"),
        ({"parameters": 400.0}, "doubtful", "leaves none to test them by"),
        ({"stopped": "the choice of the equation"}, "doubtful", "give more time"),
        ({"target_r2": 0.02}, "no model", "nothing was found that is much better than a constant"),
        ({"target_r2": 0.02, "is_known": True}, "no model", "it is not much better than a constant"),
        ({"error": math.inf, "target_r2": None}, "no model", "not finite"),
    ],
)
def test_a_target_goes_through_the_same_table(change: dict[str, object], grade: str, said: str) -> None:
    verdict = judge(replace(TARGET, **change))
    assert verdict.grade == grade
    assert said.lower() in verdict.reason.lower()
    assert not verdict.reason[0].islower()
    assert verdict.reason.endswith(".")


def test_an_exact_target_stands_out_from_chance_by_odds_of_200() -> None:
    assert judge(EXACT_TARGET).grade == "exact"
    assert "level of rounding" in judge(EXACT_TARGET).reason
    assert judge(replace(EXACT_TARGET, null_nats=5.0)).grade == "good"
    assert judge(replace(EXACT_TARGET, null_nats=2.0)).grade == "doubtful"
    assert judge(replace(EXACT_TARGET, target_uncertainty=1e-3)).grade == "good"


def test_a_model_that_was_not_simulated_along_its_trajectories_is_doubtful() -> None:
    verdict = judge(Evidence(error=3e-14, target_r2=1.0, is_unsimulated=True))
    assert verdict.grade == "doubtful"
    assert "not simulated along the trajectories" in verdict.reason


QUIET = replace(CLEAN, noise=1.5e-5, residuals=noise(2e-5))
"""Noise of 0.75e-5 of the deviation, which is 2, and what is left is 1e-5 of it."""


def test_what_counts_as_clean_and_exact_is_relative_to_the_deviation() -> None:
    assert judge(QUIET).grade == "exact"
    assert judge(replace(QUIET, residuals=noise(4e-5))).grade == "good"
    assert judge(replace(QUIET, noise=2.5e-5)).grade == "good"


def test_a_constant_is_known_to_a_share_of_its_estimate() -> None:
    rounded = constant(3.0, 1e-6, 1e-8, (0.0, 3.0))
    assert "the constant 3 is known to 1 % only" in judge(replace(CLEAN, constants=(rounded,))).reason
    unfitted = constant(3.0, None, 0.3, (2.0, 4.0))
    assert "the constant 3 is known to 10 % only" in judge(replace(CLEAN, constants=(unfitted,))).reason
    below = constant(-3.0, -3.0, 0.3, (-3.0, -3.0))
    assert "the constant -3 is known to 10 % only" in judge(replace(CLEAN, constants=(below,))).reason
    crumb = constant(-1e-12, -1e-12, 1e-9, (-2e-9, 2e-9))
    assert "the constant -1e-12 cannot be told from 0" in judge(replace(CLEAN, constants=(crumb,))).reason
    assert judge(replace(CLEAN, constants=())).grade == "exact"
    assert judge(replace(CLEAN, constants=(constant(0.5, 0.5),))).grade == "exact"


def test_noise_takes_its_part_of_what_held_out_trajectories_can_be_predicted() -> None:
    loud = replace(NOISY, noise=1.0, residuals=noise(1.0))
    assert outcomes(replace(loud, held_out_r2=0.7))["held-out trajectories"] == "passed"
    assert outcomes(replace(loud, held_out_r2=0.6))["held-out trajectories"] == "failed"


def test_errors_that_add_up_along_trajectories_may_be_larger_but_not_large() -> None:
    verdict = judge(replace(CLEAN, are_errors_summed=True, residuals=waves(0.02)))
    assert verdict.grade == "good"
    assert "since errors add up along trajectories" in verdict.reason
    assert judge(replace(CLEAN, residuals=waves(0.02))).grade == "doubtful"
    assert judge(replace(CLEAN, are_errors_summed=True, residuals=waves(0.8))).grade == "doubtful"


def test_a_chaotic_model_that_keeps_means_and_variances_is_good() -> None:
    verdict = judge(replace(NOISY, chaos=chaos(2.0, True, 0.3), fits_whole=None))
    assert verdict.grade == "good"
    assert "chaotic: errors grow e-fold in 2" in verdict.reason


def test_what_is_followed_nowhere_is_not_blamed_on_alternatives() -> None:
    reason = judge(replace(NOISY, prediction=prediction(12, 0, 0.0))).reason
    assert reason == "From 12 of 12 other initial states within the measured range it runs away."


@pytest.mark.parametrize(
    ("r2", "text"), [(0.99996, "R2 0.9999."), (0.98765, "R2 0.9876."), (-math.inf, "R2 -inf only")]
)
def test_what_is_not_quite_explained_is_never_rounded_up(r2: float, text: str) -> None:
    assert text in judge(replace(NOISY, held_out_r2=r2)).reason


def test_a_wild_measurement_decides_unless_there_are_outliers() -> None:
    first, *others = noise(0.1)
    wild = replace(NOISY, residuals=(np.append(first, 10.0), *others))
    assert judge(wild).grade == "doubtful"
    assert judge(replace(wild, has_outliers=True)).grade == "good"


def test_an_objection_of_another_kind_makes_a_good_equation_doubtful_and_no_other() -> None:
    for evidence, grade in (
        (NOISY, "doubtful"),
        (CLEAN, "doubtful"),
        (replace(NOISY, residuals=noise(1.9)), "no model"),
    ):
        verdict = with_objection(judge(evidence), "units", "failed", "units contradict it")
        assert verdict.grade == grade
        assert verdict.checks[-1] == Check(name="units", outcome="failed", reason="units contradict it")


def test_the_best_of_several_orders_of_rows_is_a_pattern_less_often() -> None:
    """Chance has as many goes as there are columns to sort the rows by."""
    draws = np.random.default_rng(0).normal(0.0, 0.1, 81)
    patterned = replace(TARGET, residuals=(draws[1:] + 0.3 * draws[:-1],))
    alone = patterned.statistics.patterned
    assert replace(patterned, orders=5).statistics.patterned == pytest.approx(5.0 * alone)
    assert replace(patterned, orders=10**9).statistics.patterned == 1.0


def test_noise_that_is_known_from_the_residuals_alone_is_said_to_be() -> None:
    """Few rows hide it: what is rough in the residuals stands for it, and a departure that matters is none of these."""
    rough = replace(NOISY, residuals=noise(0.1), noise=0.1, is_noise_residual=True)
    check = next(check for check in judge(rough).checks if check.name == "residual size")
    assert (check.outcome, check.power) == ("passed", rough.largest_departure)
    assert "as rough as noise" in check.reason
    large = replace(rough, residuals=noise(1.0), noise=1.0)
    assert outcomes(large)["residual size"] == "not made"  # a quarter of the variance is no small departure
