"""Scores of the Common Task Framework: the best score is 100, and each score reads only its own rows."""

import numpy as np
import pytest

from benchmarks.contests.protocol import (
    FORECAST,
    PAIRS,
    SCORES,
    long_score,
    noise_of,
    reconstruction_score,
    short_score,
)

RANDOM = np.random.default_rng(3)
TRUTH = RANDOM.normal(size=(FORECAST, 3))


@pytest.mark.parametrize("name", SCORES)
def test_the_truth_scores_100(name: str) -> None:
    assert SCORES[name](TRUTH, TRUTH) == pytest.approx(100.0)


def test_a_prediction_of_zero_scores_0_and_no_score_is_below_minus_100() -> None:
    assert reconstruction_score(TRUTH, 0.0 * TRUTH) == pytest.approx(0.0)
    assert reconstruction_score(TRUTH, 1e6 * TRUTH) == -100.0
    assert reconstruction_score(TRUTH, np.full_like(TRUTH, np.nan)) == -100.0
    assert long_score(TRUTH, TRUTH + 100.0) == -100.0


def test_a_short_score_reads_the_first_20_rows() -> None:
    later = TRUTH.copy()
    later[20:] = 0.0
    assert short_score(TRUTH, later) == pytest.approx(100.0)
    later[19] += 1.0
    assert short_score(TRUTH, later) < 100.0


def test_a_long_score_compares_the_values_of_the_last_500_rows_in_any_order() -> None:
    shuffled = TRUTH.copy()
    shuffled[-500:] = RANDOM.permutation(TRUTH[-500:])
    shuffled[:-500] = 0.0
    assert long_score(TRUTH, shuffled) == pytest.approx(100.0)


def test_noise_of_smooth_rows() -> None:
    times = 0.01 * np.arange(5_000)
    smooth = np.stack([np.sin(times), np.cos(times), times], axis=1)
    assert noise_of(smooth) < 1e-9
    assert noise_of(smooth + RANDOM.normal(0.0, 0.5, smooth.shape)) == pytest.approx(0.5, rel=0.05)


def test_the_contest_has_twelve_scores() -> None:
    assert sum(len(pair.scores) for pair in PAIRS) == 12
    assert [pair.number for pair in PAIRS] == [*range(1, 10)]
