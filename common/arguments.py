"""What the command lines of both programs read in the same way. Light, because ``--help`` must be instant."""

import argparse


def seconds(text: str) -> float:
    """Return a number of seconds, at least 0; raises ArgumentTypeError."""
    try:
        number = float(text)
    except ValueError:
        number = -1.0
    if 0.0 <= number < 1e9:
        return number
    raise argparse.ArgumentTypeError(f"a number of seconds was expected, but {text!r} was given")
