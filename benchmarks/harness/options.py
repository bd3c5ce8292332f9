"""Kinds of option that several benchmarks have."""

import argparse
import math


def whole(text: str) -> int:
    """Return a number from 1 on."""
    if not text.isascii() or not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"a whole number from 1 on was expected, but {text!r} was given")
    return int(text)


def positive(text: str) -> float:
    """Return a number above 0."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not 0.0 < number < math.inf:
        raise argparse.ArgumentTypeError(f"a number above 0 was expected, but {text!r} was given")
    return number
