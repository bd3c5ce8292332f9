"""The verb that asks whether a coordinator answers."""

import argparse
import time

from atoll.cli.exit_codes import DONE
from atoll.cli.request import address_of
from atoll.client.client import connected
from atoll.terminal.output import as_json, say


def ping(options: argparse.Namespace) -> int:
    """Greet the coordinator and say how long it took; UnreachableError when it did not answer in ``options.wait``.

    The answer comes from the loop that all else goes through, which a coordinator that hangs does not turn.
    """
    address = address_of(options)
    began = time.monotonic()
    with connected(address, options.wait) as client:
        seconds, welcome = time.monotonic() - began, client.welcome
    answer = {"version": welcome.version, "incarnation": welcome.incarnation, "seconds": seconds}
    text = (
        f"coordinator {welcome.version} at {address} answers, in {1000 * seconds:.0f} ms (start {welcome.incarnation})"
    )
    say(as_json(answer) if options.json else text)
    return DONE
