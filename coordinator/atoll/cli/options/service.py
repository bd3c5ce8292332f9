"""The options of the verbs that run or examine a service: ``serve``, ``router``, ``doctor``. Standard library only."""

import argparse
import re
from collections.abc import Callable
from typing import Final, TypeAlias

from atoll_core.command_line import Parser, add_log_options, add_tls_options, seconds

DEFAULT_LISTEN: Final = "tcp/127.0.0.1:7447"
DEFAULT_STATE: Final = "atoll-state"
DEFAULT_WAIT_S: Final = 10.0
DEFAULT_KEEP: Final = "90d,8G"
_AGES: Final = {"s": 1, "m": 60, "h": 3600, "d": 86400}
_SIZES: Final = {"M": 10**6, "G": 10**9, "T": 10**12}

Verbs: TypeAlias = "argparse._SubParsersAction[Parser]"
"""What verbs are added to."""

Verb = Callable[[Verbs, str, str], argparse.ArgumentParser]
"""Adds a verb with its one-line description and returns its parser."""


def add_serve(verb: Verb, verbs: Verbs) -> None:
    """Add ``serve``."""
    parser = verb(verbs, "serve", "run the coordinator for workers and jobs of any machine")
    place = parser.add_mutually_exclusive_group()
    _add_listen(place)
    place.add_argument(
        "--router",
        metavar="tcp/HOST:PORT",
        help="do not listen, but join a router there (coordinator router, or zenohd), as workers and clients do",
    )
    parser.add_argument(
        "--state", default=DEFAULT_STATE, metavar="DIR", help=f"folder of the job store (default: {DEFAULT_STATE})"
    )
    parser.add_argument(
        "--keep", type=keep, default=DEFAULT_KEEP, metavar="AGE,SIZE",
        help="delete ended jobs, the oldest first, that ended longer ago (30m, 12h, 90d) or while the store takes more "
        f"(500M, 8G); one of the two may be left out, and `all` keeps all (default: {DEFAULT_KEEP})",
    )  # fmt: skip
    _add_connect_file(parser)
    add_tls_options(parser)
    _add_roster(parser)
    add_log_options(parser)
    parser.add_argument(
        "--wait",
        type=seconds,
        default=DEFAULT_WAIT_S,
        metavar="SECONDS",
        help="how long --router may take to be there (default: %(default)g)",
    )


def keep(text: str) -> tuple[int | None, int | None]:
    """Return seconds and bytes of ``90d,8G``, None for what is left out; raises ArgumentTypeError."""
    if text == "all":
        return None, None
    limits: dict[str, int] = {}
    for part in text.split(","):
        match = re.fullmatch("([1-9][0-9]{0,5})([smhdMGT])", part)
        kind = "age" if match and match[2] in _AGES else "size"
        if match is None or kind in limits:
            raise argparse.ArgumentTypeError(
                f"an age such as 90d, a size such as 8G, both as 90d,8G, or all was expected, but {text!r} was given"
            )
        limits[kind] = int(match[1]) * (_AGES | _SIZES)[match[2]]
    return limits.get("age"), limits.get("size")


def add_router(verb: Verb, verbs: Verbs) -> None:
    """Add ``router``."""
    parser = verb(
        verbs, "router", "pass messages on: for a site of its own, or to keep connections while serve restarts"
    )
    _add_listen(parser)
    parser.add_argument(
        "--connect",
        action="append",
        default=[],
        metavar="tcp/HOST:PORT",
        help="the router, or the coordinator, to which this one passes on what is not for its site; repeatable",
    )
    _add_connect_file(parser)
    add_tls_options(parser)
    _add_roster(parser)
    add_log_options(parser)


def add_doctor(verb: Verb, verbs: Verbs) -> argparse.ArgumentParser:
    """Add ``doctor`` and return its parser, which lacks the options on data."""
    parser = verb(
        verbs, "doctor", "examine this machine, a coordinator and data files, and say what to do; 1: problems"
    )
    parser.add_argument("data", nargs="*", metavar="DATA", help="data files to read as `submit` would")
    parser.add_argument(
        "--connect", metavar="tcp/HOST:PORT", help="the coordinator to examine (default: $ATOLL_CONNECT, if set)"
    )
    parser.add_argument(
        "--listen", metavar="tcp/HOST:PORT", help="an address at which a coordinator shall listen: is it free?"
    )
    parser.add_argument("--state", metavar="DIR", help="the folder of a coordinator's job store (default: the current)")
    parser.add_argument(
        "--quick", action="store_true", help="look only whether the coordinator's address accepts connections"
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    add_tls_options(parser)
    return parser


def _add_listen(parser: argparse._ActionsContainer) -> None:
    parser.add_argument(
        "--listen",
        default=DEFAULT_LISTEN,
        metavar="tcp/HOST:PORT",
        help=f"where workers and clients connect; tcp/0.0.0.0:7447 for every network (default: {DEFAULT_LISTEN})",
    )


def _add_connect_file(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--connect-file",
        metavar="FILE",
        help="write the addresses to connect to there, once they can be connected to; for island-worker --connect-file",
    )


def _add_roster(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--roster", metavar="FILE", help='who may do what, by the names in certificates (TOML: lab1 = "worker")'
    )
