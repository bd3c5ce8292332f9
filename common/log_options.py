"""The options of a program that logs. Light: ``--help`` needs them."""

from typing import Any, Final

FORMATS: Final = ("text", "json")
LEVELS: Final = ("debug", "info", "warning", "error")


def add_log_options(parser: Any) -> None:
    """Add ``--log-format`` and ``--log-level`` to an ``argparse`` parser; see `common.logs.configure`."""
    parser.add_argument(
        "--log-format", choices=FORMATS, default="text", help="form of the log on stderr (default: text)"
    )
    parser.add_argument(
        "--log-level", choices=LEVELS, default="info", help="the least level that is logged (default: info)"
    )
