"""Types of options that both programs have."""

import argparse
import errno
import io

import pytest

from atoll_core.command_line import Parser, duration, seconds, whole_number
from atoll_core.errors import AtollError


@pytest.mark.parametrize(
    ("text", "expected"),
    [("90", 90.0), ("90s", 90.0), ("1.5h", 5400.0), ("2m", 120.0), ("2min", 120.0), ("1d", 86400.0), ("250ms", 0.25)],
)
def test_a_duration_has_a_unit_or_is_seconds(text: str, expected: float) -> None:
    assert duration(text) == expected


@pytest.mark.parametrize("text", ["", "s", "-1s", "1w", "nan", "infs", "1 m", "10^3", "1s2"])
def test_what_is_no_duration_is_said_with_examples(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="a time such as 90s, 30m or 12h was expected"):
        duration(text)


def test_numbers_outside_their_limits_are_refused() -> None:
    assert (seconds("0"), whole_number(-10, 10)("-10")) == (0.0, -10)
    for parse, text in ((seconds, "-1"), (seconds, "1e9"), (whole_number(1, 5), "6"), (whole_number(1, 5), "1.0")):
        with pytest.raises(argparse.ArgumentTypeError, match="expected"):
            parse(text)


class Full(io.StringIO):
    """A stream on a disk without room."""

    def flush(self) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")


def test_help_that_cannot_be_written_is_said() -> None:
    with pytest.raises(AtollError, match=r"the output cannot be written \(No space left on device\)"):
        Parser(prog="a").print_help(Full())
