"""``coordinator doctor``: looks at this machine, at a coordinator and at data files, and says what to do.

Every check is a function from the options to findings, and none changes anything. A check that itself breaks is a
finding, too.
"""

import argparse
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from atoll.cli.doctor import machine, network
from atoll.cli.doctor.finding import Finding, as_text, as_tree, fine, problem
from atoll.cli.exit_codes import DONE, FAILED
from atoll.terminal.output import as_json, say
from atoll_core.errors import DataError, UsageError

Check = Callable[[argparse.Namespace], Iterable[Finding]]


def doctor(options: argparse.Namespace) -> int:
    """Examine and print; return 1 when there is a problem, else 0."""
    findings = examine(options, [network.check_address] if options.quick else CHECKS)
    say(as_json(as_tree(findings)) if options.json else as_text(findings))
    return FAILED if any(finding.grade == "problem" for finding in findings) else DONE


def examine(options: argparse.Namespace, checks: Sequence[Check]) -> list[Finding]:
    """Return what these checks find."""
    findings: list[Finding] = []
    for check in checks:
        try:
            findings += list(check(options))
        except Exception as error:  # whatever is wrong with one check, the others are made
            name = check.__name__.removeprefix("check_")
            fact = f"could not be examined ({type(error).__name__}: {error})"
            findings.append(Finding(name, "problem", fact, "report this; the other findings hold"))
    return findings


def check_data(options: argparse.Namespace) -> Iterator[Finding]:
    """Read DATA with the data options that were given, as ``submit`` does; nothing is smoothed."""
    if not options.data:
        return
    from atoll.cli.options.parser import parse
    from atoll.cli.request import request_of
    from atoll_coordinator.data.columns.examination import examine
    from atoll_coordinator.data.outline import describe
    from atoll_coordinator.data.reading.files import read_table

    given = {name: value for name, value in vars(options).items() if name != "verb"}
    try:
        request = request_of(argparse.Namespace(**{**vars(parse(["submit", *options.data])), **given}))
        table = read_table([Path(name) for name in options.data], request.config.data)
        text = describe(table, request.config, has_warnings=False)
        examined = examine(table, request.config)
    except (DataError, UsageError) as error:
        yield problem("data", error)
        return
    yield fine("data", text)
    for found in examined.findings:
        yield Finding("data", "warning", found.found, found.advice)
    for remark in examined.measurements.warnings[len(examined.findings) :]:
        yield Finding("data", "warning", remark, "check that this is what you mean")


CHECKS: Sequence[Check] = (
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
"""Everything that is looked at, in this order."""
