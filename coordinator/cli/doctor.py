"""``coordinator doctor``: looks at this machine, at a coordinator and at data files, and says what to do.

Every check is a function from the options to findings, and none changes anything. A check that itself breaks is a
finding, too.
"""

import argparse
from collections.abc import Callable, Iterable, Sequence
from typing import Final

from coordinator.cli.doctor_data import check_data
from coordinator.cli.doctor_machine import (
    check_cores,
    check_kernels,
    check_memory,
    check_open_files,
    check_state,
    check_versions,
)
from coordinator.cli.doctor_network import check_coordinator, check_listen
from coordinator.cli.exits import DONE, FAILED
from coordinator.cli.finding import Finding, as_text, as_tree
from coordinator.cli.output import as_json, say

Check = Callable[[argparse.Namespace], Iterable[Finding]]

CHECKS: Final[Sequence[Check]] = (
    check_versions,
    check_cores,
    check_memory,
    check_open_files,
    check_kernels,
    check_state,
    check_listen,
    check_coordinator,
    check_data,
)
"""What is looked at, in this order."""


def doctor(options: argparse.Namespace) -> int:
    """Examine and print; return 1 when there is a problem, else 0."""
    findings = examine(options)
    say(as_json(as_tree(findings)) if options.json else as_text(findings))
    return FAILED if any(each.grade == "problem" for each in findings) else DONE


def examine(options: argparse.Namespace, checks: Sequence[Check] = CHECKS) -> list[Finding]:
    """Return what all checks find."""
    return [finding for check in checks for finding in _found(check, options)]


def _found(check: Check, options: argparse.Namespace) -> list[Finding]:
    try:
        return list(check(options))
    except Exception as error:  # whatever is wrong with one check, the others are made
        name = check.__name__.removeprefix("check_")
        found = f"could not be examined ({type(error).__name__}: {error})"
        return [Finding(name, "problem", found, "report this; the other findings hold")]
