import numpy as np
import pytest

from atoll_coordinator.data.increments import Steps, correlated_pairs, correlation_scores, split_into_bins
from atoll_core.data.dataset import FloatArray
from tests.unit.coordinator.data.increments.paths import circling, steps_of


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
