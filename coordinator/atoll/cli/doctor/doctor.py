"""``coordinator doctor``: looks at this machine, at a coordinator and at data files, and says what to do.

Every check is a function from the options to findings, and none changes anything. A check that itself breaks is a
finding, too.
"""

import argparse
from collections.abc import Callable, Iterable, Sequence
from typing import Final

from atoll.cli.doctor.address import check_address
from atoll.cli.doctor.finding import Finding, as_text, as_tree
from atoll.cli.exit_codes import DONE, FAILED
from atoll.terminal.output import as_json, say

Check = Callable[[argparse.Namespace], Iterable[Finding]]

QUICK: Final[Sequence[Check]] = (check_address,)
"""What is looked at with ``--quick``; light, since it may be asked twice a minute."""


def doctor(options: argparse.Namespace) -> int:
    """Examine and print; return 1 when there is a problem, else 0."""
    findings = examine(options, QUICK if options.quick else all_checks())
    say(as_json(as_tree(findings)) if options.json else as_text(findings))
    return FAILED if any(finding.grade == "problem" for finding in findings) else DONE


def all_checks() -> Sequence[Check]:
    """Return everything that is looked at, in this order."""
    from atoll.cli.doctor import machine, network
    from atoll.cli.doctor.data import check_data

    return (
        machine.check_versions,
        machine.check_cores,
        machine.check_memory,
        machine.check_open_files,
        machine.check_kernels,
        machine.check_state,
        network.check_certificates,
        network.check_listen,
        network.check_coordinator,
        check_data,
    )


def examine(options: argparse.Namespace, checks: Sequence[Check]) -> list[Finding]:
    """Return what these checks find."""
    return [finding for check in checks for finding in _found(check, options)]


def _found(check: Check, options: argparse.Namespace) -> list[Finding]:
    try:
        return list(check(options))
    except Exception as error:  # whatever is wrong with one check, the others are made
        name = check.__name__.removeprefix("check_")
        fact = f"could not be examined ({type(error).__name__}: {error})"
        return [Finding(name, "problem", fact, "report this; the other findings hold")]
