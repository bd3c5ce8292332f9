"""Steps of processes whose noise is known: roughness, correlated noises, moments in bins."""

from collections.abc import Sequence

import numpy as np
import pytest

from atoll_coordinator.data.increments import (
    Steps,
    bin_moments,
    correlated_pairs,
    correlation_scores,
    is_driven,
    noise_rate,
    noise_shares,
    split_into_bins,
)
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray


def steps_of(states: FloatArray, step: float) -> Steps:
    """Return the steps of one trajectory (S, R) with even steps."""
    return uneven_steps_of(states, step * np.arange(states.shape[1]))


def uneven_steps_of(states: FloatArray, times: FloatArray, breaks: Sequence[int] = ()) -> Steps:
    """Return the steps of states (S, R) at `times` (R,); no step leads to the rows `breaks`, with which one begins."""
    kept = np.delete(np.arange(len(times) - 1), [row - 1 for row in breaks])
    follows = (np.arange(len(times) - 1) > 0)[kept]
    follows[np.flatnonzero(np.isin(kept, breaks))] = False
    moved = np.diff(states, axis=1)
    return Steps(
        np.ascontiguousarray(states[:, kept]), np.diff(times)[kept], np.ascontiguousarray(moved[:, kept]), follows
    )


def circling(rows: int, seed: int, correlation: float) -> FloatArray:
    """Return two states that turn about each other, with noise of variance 0.04 per time, sampled each 0.05."""
    random, step = np.random.default_rng(seed), 0.05
    normal = random.standard_normal((2, rows))
    normal[1] = correlation * normal[0] + np.sqrt(1.0 - correlation**2) * normal[1]
    states = [np.array([1.0, 0.0])]
    for row in range(rows - 1):
        x, y = states[-1]
        states.append(states[-1] + step * np.array([y - 0.1 * x, -x - 0.1 * y]) + 0.2 * np.sqrt(step) * normal[:, row])
    return np.array(states).T


LIMIT = SETTINGS.selection.least_noise


def times_of(kind: str) -> FloatArray:
    """Return times that are even, or whose steps differ sixfold."""
    random = np.random.default_rng(6)
    return 0.02 * (np.arange(1000.0) if kind == "even" else np.cumsum(random.uniform(0.3, 1.7, 1000)))


def smooth(times: FloatArray) -> FloatArray:
    return np.array([np.sin(2.0 * times), np.exp(-0.1 * times) * np.cos(times)])


@pytest.mark.parametrize("kind", ["even", "uneven"])
def test_smooth_motion_is_told_from_small_noise(kind: str) -> None:
    times = times_of(kind)
    walk = np.cumsum(1e-4 * np.random.default_rng(5).standard_normal((2, len(times))), axis=1)
    assert (noise_shares(uneven_steps_of(smooth(times), times)) < 1e-3 * LIMIT).all()
    assert (noise_shares(uneven_steps_of(smooth(times) + walk, times)) > 10.0 * LIMIT).all()


def test_differences_are_not_taken_over_the_end_of_a_trajectory() -> None:
    times = times_of("even")
    twice = np.concatenate([smooth(times), smooth(times)], axis=1)
    parted = uneven_steps_of(twice, 0.02 * np.arange(2000), breaks=[1000])
    assert (noise_shares(parted) < 1e-3 * LIMIT).all()


@pytest.mark.parametrize("kind", ["even", "uneven"])
def test_a_state_that_follows_a_noisy_one_is_told_from_one_with_noise_of_its_own(kind: str) -> None:
    random, times = np.random.default_rng(7), times_of(kind)
    fine = np.linspace(times[0], times[-1], 40_000)
    spread = np.sqrt(fine[1] - fine[0])
    noisy = np.cumsum(0.5 * spread * random.standard_normal(len(fine)))
    once = np.cumsum(noisy) * (fine[1] - fine[0])
    twice = np.cumsum(once) * (fine[1] - fine[0])
    states = np.array([np.interp(times, fine, path) for path in (noisy, once, twice, np.sin(fine))])
    steps = uneven_steps_of(states, times)
    assert [is_driven(steps, state) for state in range(4)] == [False, True, True, False]
    assert abs(noise_rate(steps, 0) / (0.455 * 0.25) - 1.0) < 0.3


def pairs_of(steps: Steps) -> list[tuple[int, int]]:
    return correlated_pairs(steps, split_into_bins(steps.points, 60))


def carried(rows: int, seed: int) -> FloatArray:
    """Return two states of which one carries the noise of the other: within a step of 0.1 they move together."""
    random = np.random.default_rng(seed)
    states, small = [np.zeros(2)], 0.01
    for normal in 0.5 * np.sqrt(small) * random.standard_normal((rows, 10, 2)):
        x, y = states[-1]
        for one, other in normal.tolist():
            x, y = x + small * (4.0 * y - x) + one, y - small * y + other
        states.append(np.array([x, y]))
    return np.array(states).T


def test_noise_that_is_carried_over_by_the_drift_is_no_correlation() -> None:
    steps = steps_of(carried(3000, seed=1), 0.1)
    moved = np.corrcoef(steps.increments)[0, 1]
    assert moved > 0.06, "steps go together, beyond chance"
    assert pairs_of(steps) == []


@pytest.mark.parametrize(("correlation", "pairs"), [(0.0, []), (0.2, [(0, 1)]), (-0.2, [(0, 1)])])
def test_correlated_noises_are_seen(correlation: float, pairs: list[tuple[int, int]]) -> None:
    assert pairs_of(steps_of(circling(3000, 3, correlation), 0.05)) == pairs


def test_a_correlation_that_has_either_sign_by_turns_is_seen() -> None:
    random = np.random.default_rng(4)
    place = np.cumsum(random.standard_normal((1, 3000)), axis=1) % 20.0
    one, other = random.standard_normal((2, 3000))
    other = np.where(place[0] > 10.0, 1.0, -1.0) * (0.7 * one) + 0.7 * other
    states = np.cumsum([one, other], axis=1)
    steps = steps_of(states, 1.0)
    bins = split_into_bins(place[:, :-1], 30)
    whole = float(np.corrcoef(steps.increments)[0, 1])
    assert abs(whole) < 0.1
    assert correlated_pairs(steps, bins) == [(0, 1)]


def test_scores_are_normal_where_signs_are_chance() -> None:
    """The second is a sum over bins, whose scatter is less than that of chi-square where bins are small."""
    random = np.random.default_rng(5)
    bins = np.split(np.arange(640), 32)
    scores = np.array([
        correlation_scores(random.standard_t(3, 640) * random.standard_normal(640), bins) for _ in range(300)
    ])  # fmt: skip
    assert abs(np.mean(scores[:, 0] ** 2) - 1.0) < 0.3
    assert abs(np.mean(scores[:, 1])) < 0.2
    assert 0.7 < np.std(scores[:, 1]) < 1.1


def test_bins_part_the_rows_evenly() -> None:
    positions = np.random.default_rng(1).random((2, 1000))
    bins = split_into_bins(positions, 70)
    assert len(bins) == 64
    assert sorted(np.concatenate(bins).tolist()) == [*range(1000)]
    assert {len(rows) for rows in bins} <= {15, 16}
    assert max(np.ptp(positions[:, rows], axis=1).max() for rows in bins) < 0.4


def test_products_are_those_of_the_noise_and_not_of_the_drift() -> None:
    moments = bin_moments(steps_of(circling(4000, 1, 0.0), 0.05))
    assert [*moments.products] == [(0, 0), (1, 1)], "the drift moves both states together, their noises do not"
    assert not moments.noise.any()
    assert abs(moments.products[0, 0].mean() - 0.04) < 4.0 * 0.04 * np.sqrt(2.0 / 4000)
    slope = np.polyfit(moments.points[1], moments.drift[0] + 0.1 * moments.points[0], 1)[0]
    assert abs(slope - 1.0) < 0.1


def test_states_whose_noise_is_correlated_have_a_covariation() -> None:
    moments = bin_moments(steps_of(circling(2000, 2, 0.5), 0.05))
    assert [*moments.products] == [(0, 0), (1, 1), (0, 1)]
    assert abs(moments.products[0, 1].mean() - 0.02) < 4.0 * 0.04 / np.sqrt(2000)


def test_errors_of_measurement_are_told_from_the_noise_of_the_process() -> None:
    states = circling(4000, 3, 0.0)
    states[0] += 0.1 * np.random.default_rng(4).standard_normal(4000)
    moments = bin_moments(steps_of(states, 0.05))
    assert moments.noise[1] == 0.0
    assert abs(moments.noise[0] - 0.01) < 0.001
    assert abs(moments.products[0, 0].mean() - 0.04) < 0.015, "noise alone would add 0.4"
