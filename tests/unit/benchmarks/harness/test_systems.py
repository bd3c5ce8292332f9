"""The generator of the paper's systems."""

import numpy as np
import pytest
import sympy

from atoll_coordinator.data.reading.files import read_table
from atoll_core.config import DataConfig
from benchmarks.harness.systems import SYSTEMS, TABLE_III, TRUTH, main, trajectories


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_text_of_the_truth_is_the_field_that_is_solved(name):
    states = sympy.symbols(list(TRUTH[name]))
    for point in ((0.7, 1.3), (2.1, -0.4)):
        slopes = SYSTEMS[name].field(*point)
        for text, slope in zip(TRUTH[name].values(), slopes, strict=True):
            value = sympy.sympify(text).subs(dict(zip(states, point, strict=True)))
            assert float(value) == pytest.approx(float(slope), rel=1e-12)


@pytest.mark.parametrize("name", TABLE_III)
def test_samples_follow_the_field(name):
    """Central differences of a fine sampling agree with the right-hand side."""
    sampled = trajectories(name, step=0.001, duration=0.02)
    assert len(sampled.values) == 4
    for times, values in zip(sampled.times, sampled.values, strict=True):
        slopes = (values[2:] - values[:-2]) / (times[2:] - times[:-2])[:, None]
        truth = np.array([SYSTEMS[name].field(*state) for state in values[1:-1]])
        assert np.abs(slopes - truth).max() < 1e-3 * (1 + np.abs(truth).max())


def test_sizes_and_starts_are_those_of_the_paper():
    sampled = trajectories("lotka_volterra")
    assert [len(times) for times in sampled.times] == [100] * 4
    assert [tuple(values[0]) for values in sampled.values] == [(1, 3), (4, 1), (8, 2), (3, 3)]


@pytest.mark.slow
def test_the_seed_decides_starts_and_noise():
    first, again, other = (trajectories("glider", seed=seed, noise=0.1).values[0] for seed in (1, 1, 2))
    assert first.tolist() == again.tolist()
    assert first.tolist() != other.tolist()


def test_noise_is_a_share_of_the_spread():
    clean, noisy = (np.concatenate(trajectories("bar_magnets", 0.02, noise=noise).values) for noise in (0.0, 0.1))
    assert np.std(noisy - clean, axis=0) == pytest.approx(0.1 * clean.std(axis=0), rel=0.1)


def test_the_command_writes_files_that_are_read_back_exactly(tmp_path, capsys):
    main(["--system", "pendulum", "--step", "0.5", "--out", str(tmp_path)])
    assert capsys.readouterr().out == f"{tmp_path / 'pendulum.csv'}\n"
    table = read_table([tmp_path / "pendulum.csv"], DataConfig())
    assert table.names == ("trajectory", "t", "theta")
    values = np.concatenate(trajectories("pendulum", 0.5).values)
    assert table.column("theta").tolist() == values[:, 0].tolist()
