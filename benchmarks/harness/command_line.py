"""The command lines of the benchmarks: options that several have, and how their errors end."""

import argparse
import math
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from atoll.errors import AtollError
from atoll.machine.cores import usable_cores
from atoll_coordinator.cli.terminal.output import note


def seeds(text: str) -> list[int]:
    """Return the numbers of ``0-4``, ``3`` or ``0,2,5-7``."""
    numbers: list[int] = []
    for part in text.split(","):
        if not re.fullmatch(r"\d+(-\d+)?", part):
            raise argparse.ArgumentTypeError(f"numbers such as 0-4 or 0,2,5 were expected, but {text!r} was given")
        first, _, last = part.partition("-")
        numbers += range(int(first), int(last or first) + 1)
    return numbers


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


def add_search_options(parser: argparse.ArgumentParser, default_seeds: str, default_time: float) -> None:
    """Add the options that benchmarks of searches through a service have in common."""
    parser.add_argument("--seeds", type=seeds, default=seeds(default_seeds), help=f"such as 0-4 ({default_seeds})")
    parser.add_argument("--workers", type=int, default=2, help="worker processes (%(default)s)")
    parser.add_argument(
        "--max-time", type=float, default=default_time, metavar="SECONDS", help="end of a search (%(default)g)"
    )
    parser.add_argument("--out", type=Path, help="file for all figures as JSON")


def add_run_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that benchmarks of many runs in processes of their own have in common."""
    cores, _ = usable_cores(os.environ)
    parser.add_argument("--seeds", type=seeds, help="such as 0-9, instead of as many runs as in the paper")
    parser.add_argument("--workers", type=whole, default=cores, help="processes (%(default)s: all cores)")
    parser.add_argument("--out", type=Path, help="file for all figures as JSON")
    parser.add_argument("--picture", type=Path, help="file for the picture, such as figure.png")


@contextmanager
def plain_errors(program: str) -> Iterator[None]:
    """Turn errors meant for a person into a sentence and their exit code, an interrupt into 130."""
    try:
        yield
    except AtollError as error:
        note(f"{program}: {error}")
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        note(f"{program}: interrupted; what it had by then is in the file given by --out, if any")
        sys.exit(130)
