"""What ``coordinator doctor`` looks at in data files: whether ``submit`` would take them, and as what."""

import argparse
from collections.abc import Iterator
from pathlib import Path

from atoll.cli.doctor.finding import Finding, fine, problem
from atoll_core.errors import DataError, UsageError


def check_data(options: argparse.Namespace) -> Iterator[Finding]:
    """Read DATA with the data options that were given, as ``submit`` does; nothing is smoothed."""
    if not options.data:
        return
    from atoll.cli.options.parser import parse
    from atoll.cli.request import request_of
    from atoll_coordinator.data.reading.files import read_table
    from atoll_coordinator.data.roles.roles import assign_roles
    from atoll_coordinator.data.table_summary import describe
    from atoll_coordinator.data.trajectories.measurements import take_measurements

    given = {name: value for name, value in vars(options).items() if name != "verb"}
    try:
        request = request_of(argparse.Namespace(**{**vars(parse(["submit", *options.data])), **given}))
        table = read_table([Path(name) for name in options.data], request.config.data)
        text = describe(table, request.config)
        remarks = take_measurements(table, *assign_roles(table, request.config.data)).warnings
    except (DataError, UsageError) as error:
        yield problem("data", error)
        return
    yield fine("data", text)
    for remark in remarks:
        yield Finding("data", "warning", remark, "check that this is what you mean")
