"""The command lines of the benchmarks: options that several have, and how their errors end."""

import argparse
import math
import re
import sys
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from atoll.terminal.output import note
from atoll_core.errors import AtollError


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


Fill = Callable[[argparse.ArgumentParser], object]
"""Gives a parser something that it knows."""

Body = Callable[[Namespace], int | bool | None]


def option(*names: str, **how: Any) -> Fill:
    """Return an option or argument, described as for `argparse`."""
    return lambda parser: parser.add_argument(*names, **how)


def verb(name: str, purpose: str | None, *options: Fill) -> tuple[str, str | None, tuple[Fill, ...]]:
    """Return one of several things that a program does, with options of its own."""
    return name, purpose, options


def verbs(*known: tuple[str, str | None, tuple[Fill, ...]]) -> Fill:
    """Return the argument `verb`, one of those that are known."""

    def fill(parser: argparse.ArgumentParser) -> None:
        parsers = parser.add_subparsers(dest="verb", required=True)
        for name, purpose, options in known:
            own = parsers.add_parser(name) if purpose is None else parsers.add_parser(name, help=purpose)
            _filled(own, options)

    return fill


def one_of(*options: Fill) -> Fill:
    """Return options of which one at most is given."""
    return lambda parser: _filled(parser.add_mutually_exclusive_group(), options)


def group(title: str, *options: Fill) -> Fill:
    """Return options under a title of their own."""
    return lambda parser: _filled(parser.add_argument_group(title), options)


def _filled(part: Any, options: Sequence[Fill]) -> None:
    for fill in options:
        fill(part)


class Program:
    """A benchmark's command line: parses words and runs `body`, whose errors end in a sentence and an exit code."""

    def __init__(self, body: Body, name: str, parser: argparse.ArgumentParser) -> None:
        self.parser: Final = parser
        self._body, self._name = body, name

    def __call__(self, words: Sequence[str] | None = None) -> int:
        """Run with these words, those of the process unless given; return the exit code."""
        options = self.parser.parse_args(words)
        options.words = sys.argv[1:] if words is None else list(words)
        with plain_errors(self._name):
            return int(self._body(options) or 0)


def program(name: str, text: str | None, *options: Fill, **how: Any) -> Callable[[Body], Program]:
    """Make a function of options into a program; the first line of `text` says what it does.

    The function finds the words of the command line in `words`. `how` is for the parser.
    """
    described = {"prog": f"python -m {name}", "description": (text or "").split("\n")[0], **how}

    def made(body: Body) -> Program:
        parser = argparse.ArgumentParser(**described)
        _filled(parser, options)
        return Program(body, name, parser)

    return made


OUT: Final = option("--out", type=Path, help="file for all figures as JSON")


def workers(number: int = 2, what: str = "worker processes") -> Fill:
    """Return the option that says how many processes there are."""
    return option("--workers", type=whole, default=number, help=f"{what} (%(default)s)")


def seeds_of(default: str, text: str) -> Fill:
    """Return the option that names seeds."""
    return option("--seeds", type=seeds, default=seeds(default), help=text)


def search_options(default_seeds: str, default_time: float) -> tuple[Fill, ...]:
    """Return the options that benchmarks of searches through a service have in common."""
    limit = f"end of a search ({default_time:g})"
    return (
        seeds_of(default_seeds, f"such as 0-4 ({default_seeds})"),
        option("--workers", type=int, default=2, help="worker processes (%(default)s)"),
        option("--max-time", type=float, default=default_time, metavar="SECONDS", help=limit),
        OUT,
    )


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
