"""What the command lines of benchmarks have in common."""

import argparse

import pytest

from atoll_core.errors import DataError
from benchmarks.harness.command_line import plain_errors, seeds


@pytest.mark.parametrize(("text", "numbers"), [("0-2", [0, 1, 2]), ("7", [7]), ("0,2,5-6", [0, 2, 5, 6])])
def test_seeds_are_numbers_and_ranges(text, numbers):
    assert seeds(text) == numbers


@pytest.mark.parametrize("text", ["", "a", "1-", "-1", "1,,2"])
def test_other_seeds_are_refused(text):
    with pytest.raises(argparse.ArgumentTypeError, match="numbers such as"):
        seeds(text)


def test_an_error_for_a_person_is_a_sentence_and_its_exit_code(capsys):
    with pytest.raises(SystemExit) as ended, plain_errors("benchmarks.noise"):
        raise DataError("there are no data")
    assert ended.value.code == 2
    assert capsys.readouterr().err == "benchmarks.noise: there are no data\n"
