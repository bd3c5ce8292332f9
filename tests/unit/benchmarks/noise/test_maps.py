"""Maps of noise by length: the published cells, what is measured in each, and what a map counts."""

import argparse
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.noise.data import Key
from benchmarks.noise.judging import Outcome, outcome
from benchmarks.noise.maps import SYSTEMS, asked, case, chosen, map_of, wrong

KEY = Key("atoll", "van_der_pol", 0.2, 3, 5.0)
LAW = SYSTEMS["van_der_pol"].truths


def ended(key: Key, y: str, verdict: str) -> Outcome:
    texts = {"x": LAW["x"], "y": y}
    rows = [{"variable": name, "expression": text, "verdict": verdict} for name, text in texts.items()]
    return outcome(key, case(key), {"equations": rows, "seconds": 1.0}, {})


def test_cells_are_chosen_by_name_noise_and_length() -> None:
    assert chosen("lorenz:0.2:7,8") == [("lorenz", 0.2, 7.0), ("lorenz", 0.2, 8.0)]
    assert len(chosen(":0.05")) == 7 + 11 + 9
    assert len(chosen("roessler")) == 16 * 11
    with pytest.raises(argparse.ArgumentTypeError, match="names none"):
        chosen("lorenz:0.21")


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
