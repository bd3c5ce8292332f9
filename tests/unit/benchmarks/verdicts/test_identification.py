"""Which laws a short table tells from other textbook forms."""

import numpy as np

from atoll_core.data.dataset import FloatArray
from benchmarks.verdicts.identification import DECIDED, Measurements, leads
from benchmarks.verdicts.simulation import Run, simulate, with_numbers

DECAY = {"x": "-k1*x"}


def lead_of(noise: float, duration: float, rows: int = 10) -> float:
    """Return the lead of a decay over the other forms, its noise given as a share of the initial value."""
    run = Run({"k1": 0.7}, (20.0,), np.linspace(0.0, duration, rows))
    clean: FloatArray = simulate(with_numbers(DECAY, run.constants), run)
    values = clean[:, 0] + 20.0 * noise * np.random.default_rng(3).standard_normal(rows)
    return leads(DECAY, run, clean, Measurements({"x": values}, {"x": 20.0 * noise}))["x"]


def test_a_decay_is_told_where_it_was_followed_and_noise_is_small() -> None:
    assert lead_of(0.005, 4.0) > 10.0 * DECIDED


def test_a_decay_is_not_told_from_a_few_noisy_rows_of_its_beginning() -> None:
    assert lead_of(0.05, 0.4, 5) < DECIDED
