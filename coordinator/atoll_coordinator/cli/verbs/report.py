"""``coordinator report``: a saved result as one HTML page that needs neither network nor script."""

import argparse
from pathlib import Path

from atoll.model.saved import read_result
from atoll_coordinator.cli.exit_codes import DONE
from atoll_coordinator.cli.terminal.output import REPORT, write_report


def report(options: argparse.Namespace) -> int:
    """Write the page of ``options.result``. Return the exit code."""
    path = Path(options.result)
    if path.is_dir():
        path /= "result.json"
    write_report(path.with_name(REPORT) if options.output is None else Path(options.output), read_result(path))
    return DONE
