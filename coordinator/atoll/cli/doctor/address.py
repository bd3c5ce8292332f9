"""Whether a coordinator's address accepts connections. Light, because it may be asked twice a minute."""

import argparse
import os
from collections.abc import Iterator
from typing import Final

from atoll.cli.doctor.finding import Finding, fine
from atoll_core.errors import UsageError
from atoll_core.wire.addresses import parse_address, why_unreachable

LIMIT_S: Final = 3.0
"""How long a coordinator may take to answer."""


def check_address(options: argparse.Namespace) -> Iterator[Finding]:
    """Whether the coordinator's address accepts connections, and nothing more."""
    text = options.connect or os.environ.get("ATOLL_CONNECT")
    if not text:
        yield Finding("address", "problem", "none was named", "give --connect tcp/HOST:PORT or set ATOLL_CONNECT")
        return
    try:
        address = parse_address(text)
    except UsageError as error:
        yield Finding("address", "problem", str(error), "write it as `coordinator serve` printed it")
        return
    reason = why_unreachable(address, LIMIT_S)
    if reason is None:
        yield fine("address", f"{address} accepts connections")
    else:
        yield Finding("address", "problem", f"{address} cannot be reached: {reason}", _advice(reason))


def _advice(reason: str) -> str:
    if "not known" in reason:
        return "check the name, or use the machine's number"
    if "refused" in reason:
        return "start `coordinator serve` there, on an address that others reach (not 127.0.0.1), or check the port"
    return "check that the machine is on and that no firewall keeps this port closed"
