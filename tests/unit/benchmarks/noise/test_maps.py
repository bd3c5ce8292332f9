"""Maps of noise by length: the published cells, what is measured in each, and what a map counts."""

import argparse
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.noise.data import Key
from benchmarks.noise.judging import Outcome, outcome
from benchmarks.noise.maps import LENGTHS, NOISES, SYSTEMS, asked, case, cells, chosen, least_t, map_of, noise_of, wrong

KEY = Key("atoll", "van_der_pol", 0.2, 3, 5.0)
LAW = SYSTEMS["van_der_pol"].truths


def ended(key: Key, y: str, verdict: str) -> Outcome:
    texts = {"x": LAW["x"], "y": y}
    rows = [{"variable": name, "expression": text, "verdict": verdict} for name, text in texts.items()]
    return outcome(key, case(key), {"equations": rows, "seconds": 1.0}, {})


def test_cells_are_the_published_ones() -> None:
    assert (NOISES[0], NOISES[-1], len(NOISES)) == (0.025, 0.4, 16)
    assert len(cells()) == 16 * (7 + 11 + 9)
    assert {name: (lengths[0], lengths[-1]) for name, lengths in LENGTHS.items()} == {
        "lorenz": (4, 10), "roessler": (10, 30), "van_der_pol": (4, 12),
    }  # fmt: skip


def test_cells_are_chosen_by_name_noise_and_length() -> None:
    assert chosen("lorenz:0.2:7,8") == [("lorenz", 0.2, 7.0), ("lorenz", 0.2, 8.0)]
    assert len(chosen(":0.05")) == 7 + 11 + 9
    assert len(chosen("roessler")) == 16 * 11
    with pytest.raises(argparse.ArgumentTypeError, match="names none"):
        chosen("lorenz:0.21")


def test_noise_is_a_share_of_the_deviation_of_all_values_of_the_longest_trajectory() -> None:
    assert noise_of("van_der_pol") == pytest.approx(1.42, abs=0.1)
    longest, quiet = (case(replace(KEY, length=12.0, level=level)) for level in (0.4, 0.2))
    noisy = longest.table.columns[1:] - np.array([*longest.clean.values()])
    assert noisy.std() == pytest.approx(0.4 * noise_of("van_der_pol"), rel=0.05)
    assert quiet.table.columns[1:] - np.array([*quiet.clean.values()]) == pytest.approx(0.5 * noisy)


def test_a_shorter_table_is_the_beginning_of_a_longer_one() -> None:
    short, long = (case(replace(KEY, length=length)).table.columns for length in (5.0, 6.0))
    assert (short.shape, long.shape) == ((3, 500), (3, 600))
    assert short[0, 0] == pytest.approx(0.01)
    assert case(KEY).clean["x"][0] == -2.0
    assert long[:, :500] == pytest.approx(short, rel=1e-6)
    other = case(replace(KEY, seed=4)).table.columns
    assert not np.allclose(other[1:], short[1:])


def test_a_map_counts_draws_whose_equations_are_all_right_and_wrong_verdicts() -> None:
    right = ended(KEY, "0.48*y - 0.52*x**2*y - 0.97*x", "good")
    linear = ended(replace(KEY, seed=4), "0.8*y - 2.0*x", "good")
    doubted = ended(replace(KEY, seed=5), "0.8*y - 2.0*x", "doubtful")
    assert [line.partition(":")[0] for line in wrong([right, linear, doubted])] == ["WRONG good"]
    row = map_of("van_der_pol", [right, linear, doubted]).splitlines()[-1]
    assert row.split()[:3] == ["20.0%", "1/3", "!1"]
    assert "not searched" in asked("van_der_pol", [right])
    long = [replace(one, key=replace(one.key, length=10.0)) for one in (right, linear)]
    assert "at 20 % 1 of 2 (50%)" in asked("van_der_pol", long)


def test_more_noise_tells_less() -> None:
    assert least_t("van_der_pol", 0.1, 8.0) > 2.0 * least_t("van_der_pol", 0.4, 8.0) > 2.0
