"""Trends: what rises is told from what only varies."""

import pytest

from atoll_core.search.seeding import Stream
from benchmarks.operations.trend import trend

TIMES = [5.0 * step for step in range(200)]


def noise(seed: int, memory: float = 0.0) -> list[float]:
    """Normal-ish numbers, each going together with the one before."""
    stream, values, last = Stream(seed), [], 0.0
    for _ in TIMES:
        last = memory * last + sum(stream.uniform() for _ in range(12)) - 6.0
        values.append(last)
    return values


def test_a_line_has_its_slope_and_no_error() -> None:
    line = trend(TIMES, [100.0 + 0.5 * at for at in TIMES])
    assert line.slope == pytest.approx(0.5)
    assert line.error == pytest.approx(0.0, abs=1e-9)
    assert line.rise == pytest.approx(0.5 * TIMES[-1])
    assert not line.is_flat


@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_errors_are_as_large_as_slopes_vary(memory: float) -> None:
    """Of series without a trend, few have a slope beyond two standard errors, also when neighbours go together."""
    lines = [trend(TIMES, noise(seed, memory)) for seed in range(60)]
    beyond = sum(abs(line.slope) > 2.0 * line.error for line in lines)
    assert beyond <= 12


def test_a_rise_in_noise_is_seen_but_a_small_one_does_not_matter() -> None:
    values = noise(1)
    assert not trend(TIMES, [100.0 + 0.01 * at + value for at, value in zip(TIMES, values, strict=True)]).is_flat
    assert trend(TIMES, [1000.0 + 0.01 * at + value for at, value in zip(TIMES, values, strict=True)]).is_flat
