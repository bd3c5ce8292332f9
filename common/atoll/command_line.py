"""What the command lines of both programs share. Light, because ``--help`` must be instant."""

import argparse
from typing import Any, Final

LOG_FORMATS: Final = ("text", "json")
LOG_LEVELS: Final = ("debug", "info", "warning", "error")

TLS_OPTIONS: Final = {
    "--tls-ca": ("ATOLL_TLS_CA", "certificate of the authority that both sides trust"),
    "--tls-cert": ("ATOLL_TLS_CERT", "our certificate"),
    "--tls-key": ("ATOLL_TLS_KEY", "the certificate's private key, unencrypted"),
}
"""The option of each file, the environment variable in its place, and what the file is (all PEM)."""


def seconds(text: str) -> float:
    """Return a number of seconds, at least 0; raises ArgumentTypeError."""
    try:
        number = float(text)
    except ValueError:
        number = -1.0
    if 0.0 <= number < 1e9:
        return number
    raise argparse.ArgumentTypeError(f"a number of seconds was expected, but {text!r} was given")


def add_log_options(parser: Any) -> None:
    """Add ``--log-format`` and ``--log-level`` to an ``argparse`` parser; see `atoll.logs.configure`."""
    parser.add_argument(
        "--log-format", choices=LOG_FORMATS, default="text", help="form of the log on stderr (default: text)"
    )
    parser.add_argument(
        "--log-level", choices=LOG_LEVELS, default="info", help="the least level that is logged (default: info)"
    )
