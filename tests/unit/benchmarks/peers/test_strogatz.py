"""The Strogatz label files: what must be there, and the levels of noise."""

import argparse

import pytest

from benchmarks.peers.strogatz import levels, main


def test_levels_of_noise_are_numbers_and_none_by_default():
    assert levels("0,0.001,0.1,0.1") == [0.0, 0.001, 0.1]
    assert main.parser.parse_args(["--data", "d"]).noise == [0.0]


@pytest.mark.parametrize("text", ["", "-1", "0.1,", "a", "nan", "inf"])
def test_other_levels_are_refused(text):
    with pytest.raises(argparse.ArgumentTypeError, match="levels such as"):
        levels(text)
