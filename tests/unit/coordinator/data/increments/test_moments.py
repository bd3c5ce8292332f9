import numpy as np

from atoll_coordinator.data.increments import bin_moments, split_into_bins
from tests.unit.coordinator.data.increments.paths import circling, steps_of


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
