"""Verdicts: every grade can be reached, what was not tested is not passed, and the sentence says why."""

import math
from typing import Any, get_args

import numpy as np
import pytest
from scipy import special

from atoll_coordinator.model.inference.residuals import residual_statistics
from atoll_coordinator.model.inference.verdict import RULES, add_objection, judge, make_checks
from atoll_coordinator.model.refinement import JobKind
from atoll_coordinator.result.equations import Check
from tests.unit.coordinator.model.inference.cases import (
    CLEAN,
    CRUMB,
    EXACT_TARGET,
    FAILED,
    NOISY,
    NOT_MADE,
    OF_TARGETS,
    SENTENCES,
    SHARP,
    SURE,
    TARGET,
    UNSIMULATED,
    noise,
    replace,
    sentences,
    waves,
)  # fmt: skip
from tests.unit.coordinator.model.parts import chaos, constant


def outcomes(evidence: Any) -> dict[str, str]:
    return {check.name: check.outcome for check in judge(evidence).checks}


def test_sentences_are_those_in_the_file() -> None:
    """Their words are pinned here and in no other test."""
    written = SENTENCES.read_text("utf-8")
    assert sentences() == written, "run: python -m tests.unit.coordinator.model.inference.cases"


def cases(by_name: dict[str, tuple[dict[str, object], ...]]) -> list[tuple[str, dict[str, object]]]:
    return [(name, change) for name, changes in by_name.items() for change in changes]


@pytest.mark.parametrize(("name", "change"), cases(FAILED))
def test_a_check_that_fails_makes_an_equation_doubtful(name: str, change: dict[str, object]) -> None:
    verdict = judge(replace(NOISY, **change))
    assert verdict.grade == ("no model" if name == "explained variance" else "doubtful")
    assert outcomes(replace(NOISY, **change))[name] == "failed"


@pytest.mark.parametrize(("name", "change"), cases(NOT_MADE))
@pytest.mark.parametrize("evidence", [NOISY, CLEAN], ids=["noisy", "clean"])
def test_a_check_that_was_not_made_has_not_passed(evidence: Any, name: str, change: dict[str, object]) -> None:
    changed = replace(evidence, **change)
    assert judge(changed).grade == "doubtful"
    assert outcomes(changed)[name] == "not made"


@pytest.mark.parametrize(("grade", "change"), cases(OF_TARGETS))
def test_a_target_goes_through_the_same_table(grade: str, change: dict[str, object]) -> None:
    assert judge(replace(TARGET, **change)).grade == grade


def test_a_good_equation_may_be_chaotic_or_lead_outside_of_the_measured_range() -> None:
    assert judge(replace(NOISY, chaos=chaos(2.0, True, 0.3), fits_whole=None)).grade == "good"
    beyond = judge(replace(NOISY, prediction=SURE.replaced(reached=3.51)))
    assert (beyond.grade, "3.51" in beyond.reason) == ("good", True)


def test_r2_is_never_rounded_up() -> None:
    assert "0.9999" in judge(replace(NOISY, held_out_r2=0.99996)).reason


def test_every_check_applies_to_some_kind_of_job_and_every_kind_has_checks() -> None:
    assert all(rule.kinds for rule in RULES)
    assert {kind for rule in RULES for kind in rule.kinds} == {*get_args(JobKind)}


@pytest.mark.parametrize("evidence", [NOISY, CLEAN, TARGET, EXACT_TARGET])
def test_of_checks_that_apply_all_have_a_reason_and_passed(evidence: Any) -> None:
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
    assert [*make_checks(evidence)] == [
        rule.name for rule in RULES if evidence.kind in rule.kinds and not rule.is_exactness
    ]


def test_every_check_of_what_was_not_simulated_is_named() -> None:
    """None is left out in silence, and the sentence says once what is missing."""
    verdict = judge(UNSIMULATED)
    made = {check.name: check.outcome for check in verdict.checks}
    assert set(made) == {rule.name for rule in RULES if "trajectories" in rule.kinds and not rule.is_exactness}
    assert made["simulation"] == "failed"
    others = ("residual size", "residual pattern", "poles", "no equation", "distinct rows", "alternative equations")
    assert {made[name] for name in (*others, "long run")} == {"not made"}
    assert verdict.reason.count("not simulated") == 1


def test_residuals_of_integration_have_a_pattern_whatever_the_noise_is_taken_for() -> None:
    """Eight rows may be taken for noisy where there is no noise; what is left is as small as errors of integration."""
    tiny = replace(NOISY, residuals=waves(1e-9))
    assert outcomes(tiny)["residual pattern"] == "passed"
    assert outcomes(replace(NOISY, residuals=waves(0.05)))["residual pattern"] == "failed"


def test_a_simulation_without_noise_and_without_error_is_exact() -> None:
    verdict = judge(CLEAN)
    assert verdict.grade == "exact"
    assert {"precision", "other laws", "precision of constants"} <= set(outcomes(CLEAN))


def test_a_test_that_would_have_seen_nothing_has_not_passed() -> None:
    """With so much noise in so few rows a departure of any size looks like noise."""
    blind = replace(NOISY, residuals=noise(1.4, rows=3), noise=1.4, parameters=2.0)
    (size,) = (check for check in judge(blind).checks if check.name == "residual size")
    assert size.outcome == "not made"
    assert size.power is not None
    assert size.power > 0.1
    assert judge(blind).grade == "doubtful"
    same_noise = replace(NOISY, residuals=noise(0.6), noise=0.6)
    assert judge(same_noise).grade == "good"


def test_the_power_of_tests_grows_with_rows() -> None:
    few, many = (residual_statistics(noise(0.1, rows=rows), 0.1, 3.0) for rows in (4, 100))
    assert few.detectable_ratio > many.detectable_ratio >= 1.25
    assert few.detectable_correlation > many.detectable_correlation >= 0.1
    assert math.isinf(residual_statistics(noise(0.1, rows=1), 0.1, 4.0).detectable_ratio)


@pytest.mark.parametrize("level", [2e-4, 1e-3])
def test_small_residuals_are_tested_where_the_noise_is_known(level: float) -> None:
    """Seven times the noise and a pure pattern are a departure, also below a thousandth of the deviation."""
    quiet = replace(NOISY, noise=level / 7.0, residuals=waves(level))
    verdict = judge(quiet)
    assert verdict.grade == "doubtful"
    assert "times the noise" in verdict.reason
    assert "follows a pattern" in verdict.reason
    assert judge(replace(CLEAN, residuals=waves(1e-4))).grade == "good"


def test_few_interpolated_rows_do_not_exclude_noise() -> None:
    few = replace(CLEAN, residuals=noise(0.02, rows=2), noise_estimate=0.008, parameters=2.0)
    assert outcomes(few)["residual size"] == "passed"
    assert outcomes(replace(few, residuals=noise(0.02)))["residual size"] == "failed"


@pytest.mark.parametrize(("factor", "outcome"), [(0.95, "passed"), (1.05, "failed")])
def test_residuals_exceed_the_noise_of_an_interpolated_state_by_the_f_test(factor: float, outcome: str) -> None:
    """The noise comes from second differences, which have 18/35 degrees of freedom per row."""
    few = replace(CLEAN, residuals=noise(0.02, rows=2), parameters=2.0)
    limit = special.fdtri(6.0, 18.0 / 35.0 * few.rows, 0.99) * factor
    estimated = few.statistics.standard_deviation / math.sqrt(limit)
    assert outcomes(replace(few, noise_estimate=estimated))["residual size"] == outcome


@pytest.mark.parametrize("part", ["constants", "unit_coefficients"])
def test_a_term_that_may_follow_errors_of_a_solver_is_not_exact(part: str) -> None:
    verdict = judge(replace(CLEAN, **{part: (*SHARP, CRUMB)}))
    assert verdict.grade == "good"
    assert "4.6e-07" in verdict.reason


def test_an_equation_that_others_agree_with_on_the_curve_alone_is_not_exact() -> None:
    """Odds of one in two hundred are what an exact verdict may be wrong by."""
    assert judge(replace(CLEAN, odds_of_alternatives=0.0049)).grade == "exact"
    unsure = judge(replace(CLEAN, odds_of_alternatives=0.0052))
    assert unsure.grade == "good"
    assert "easure from x = 1, y = 2" in unsure.reason
    doubted = judge(replace(CLEAN, odds_of_alternatives=1.0, alternative=0.0))
    assert doubted.grade == "doubtful"


def test_a_factor_of_one_that_another_can_stand_for_is_no_doubt() -> None:
    loose = constant(1.0, 1.0, np.inf, None, identifiable=False)
    assert judge(replace(CLEAN, unit_coefficients=(loose,))).grade == "exact"


def test_two_doubts_are_enough() -> None:
    reason = judge(replace(NOISY, residuals=waves(0.3), alternative=0.5)).reason
    assert "times the noise" in reason
    assert "follows a pattern" in reason
    assert "another equation" not in reason


def test_an_exact_target_stands_out_from_chance_by_odds_of_200() -> None:
    assert judge(EXACT_TARGET).grade == "exact"
    assert "level of rounding" in judge(EXACT_TARGET).reason
    assert judge(replace(EXACT_TARGET, null_nats=5.0)).grade == "good"
    assert judge(replace(EXACT_TARGET, null_nats=2.0)).grade == "doubtful"
    assert judge(replace(EXACT_TARGET, uncertainty=1e-3)).grade == "good"


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
    assert "the constant -1e-12" in judge(replace(CLEAN, constants=(crumb,))).reason
    assert judge(replace(CLEAN, constants=())).grade == "exact"
    assert judge(replace(CLEAN, constants=(constant(0.5, 0.5),))).grade == "exact"


def test_noise_takes_its_part_of_what_held_out_trajectories_can_be_predicted() -> None:
    loud = replace(NOISY, noise=1.0, residuals=noise(1.0))
    assert outcomes(replace(loud, held_out_r2=0.7))["held-out trajectories"] == "passed"
    assert outcomes(replace(loud, held_out_r2=0.6))["held-out trajectories"] == "failed"


def test_errors_that_add_up_along_trajectories_may_be_larger_but_not_large() -> None:
    verdict = judge(replace(CLEAN, are_errors_summed=True, residuals=waves(0.02)))
    assert verdict.grade == "good"
    assert judge(replace(CLEAN, residuals=waves(0.02))).grade == "doubtful"
    assert judge(replace(CLEAN, are_errors_summed=True, residuals=waves(0.8))).grade == "doubtful"


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
        verdict = add_objection(judge(evidence), "units", "failed", "units contradict it")
        assert verdict.grade == grade
        assert verdict.checks[-1] == Check(name="units", outcome="failed", reason="units contradict it")


def test_the_best_of_several_orders_of_rows_is_a_pattern_less_often() -> None:
    """Chance has as many goes as there are columns to sort the rows by."""
    draws = np.random.default_rng(0).normal(0.0, 0.1, 81)
    pattern_probability = replace(TARGET, residuals=(draws[1:] + 0.3 * draws[:-1],))
    alone = pattern_probability.statistics.pattern_probability
    assert replace(pattern_probability, orders=5).statistics.pattern_probability == pytest.approx(5.0 * alone)
    assert replace(pattern_probability, orders=10**9).statistics.pattern_probability == 1.0


def test_noise_that_is_known_from_the_residuals_alone_is_said_to_be() -> None:
    """Few rows hide it: what is rough in the residuals stands for it, and a departure that matters is none of these."""
    rough = replace(NOISY, residuals=noise(0.1), noise=0.1, is_noise_residual=True)
    check = next(check for check in judge(rough).checks if check.name == "residual size")
    assert (check.outcome, check.power) == ("passed", rough.largest_departure)
    large = replace(rough, residuals=noise(1.0), noise=1.0)
    assert outcomes(large)["residual size"] == "not made"  # a quarter of the variance is no small departure
