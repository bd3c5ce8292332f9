"""The job that the options of ``run`` or ``submit`` define: reading its data, submitting it, fetching its result.

It also has functions for saved results.
"""

import argparse
import os
import shlex
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from atoll.cli.exit_codes import DONE
from atoll.cli.parser import job_id
from atoll.client.client import Client, connected
from atoll.client.configure import configure
from atoll.client.job_options import OPTIONS, Repeated
from atoll.client.over_http import TOKEN, Whereabouts, coordinator_at
from atoll.terminal.output import as_json, note, say
from atoll_core.config import JobConfig
from atoll_core.errors import DataError, RefusedError, UsageError
from atoll_core.quoting import similar_file
from atoll_core.redaction import without_secrets
from atoll_core.wire.addresses import Destination
from atoll_core.wire.messages.views import JobView
from atoll_core.wire.topics import is_id

if TYPE_CHECKING:
    from atoll_coordinator.result.result import Result
    from atoll_core.data.table import Table

_LEAST_SHARE: Final = 0.5
"""The job gets at least this share of `--max-time`, even if this program took long to start."""

CONNECT_LIMIT_S: Final = 3.0
"""How long a coordinator may take to answer."""


@dataclass(frozen=True)
class JobRequest:
    """A job as the user described it, before its data are read."""

    job: str
    name: str
    config: JobConfig
    files: tuple[Path, ...]
    json: bool
    priority: int = 0
    shared: bool = False

    def read(self) -> "Table":
        """Read the files and print on stderr how they were read; raises DataError."""
        from atoll_coordinator.data.outline import describe
        from atoll_coordinator.data.reading.files import read_table

        table = read_table(self.files, self.config.data)
        note(describe(table, self.config))
        return table

    def rehearse(self) -> int:
        """Print how the data are read and the plan of the search; return the exit code."""
        from atoll_coordinator.data.outline import outline

        plan = outline(self.read(), self.config)
        say(as_json(plan.as_dict()) if self.json else plan.as_text())
        return DONE

    def submit(self, client: Client, table: "Table") -> JobView:
        """Upload `table` and submit the job."""
        return client.hand_in(self.job, self.name, self.config, table.to_bytes(), self.priority, shared=self.shared)

    def after(self, seconds: float) -> "JobRequest":
        """Return the request with a smaller `--max-time`: `seconds`, but at most half of `--max-time`, are
        subtracted."""
        budget = self.config.budget
        if budget.max_time is None:
            return self
        left = max(budget.max_time - seconds, _LEAST_SHARE * budget.max_time)
        budget = budget.model_copy(update={"max_time": left})
        return replace(self, config=self.config.model_copy(update={"budget": budget}))

    def result(self, client: Client, view: JobView) -> "Result | None":
        """Return the result of the ended job, with the command line of this process; None: there is no result."""
        from atoll_coordinator.result.result import Result

        try:
            result = Result.of(client.result(self.job))
        except RefusedError:
            if view.state == "done":
                raise
            return None
        words = [without_secrets(word) for word in sys.argv[1:]]  # users may share the file
        return result.model_copy(update={"command": shlex.join(["coordinator", *words])})

    def load_modules_of_result(self) -> None:
        """Load what `result` and `show` need, so that the result is shown at once when the job ends. Repeatable."""
        import atoll.text.render  # noqa: F401
        from atoll_coordinator.result.result import Result

        Result.model_rebuild()

    def show(self, result: "Result") -> None:
        """Print the equations on stdout, or the whole result as JSON."""
        from atoll.text.render import render_text

        say(as_json(result.as_dict()) if self.json else render_text(result))


def request_of(options: argparse.Namespace) -> JobRequest:
    """Return the job that the options describe; raises UsageError, or DataError if a file is missing."""
    files = tuple(Path(name) for name in options.data)
    name = options.name if options.name is not None else files[0].name
    config = config_of(options)
    request = JobRequest(
        job_id(options.id), name, config, files, options.json,
        priority=getattr(options, "priority", 0), shared=getattr(options, "share", False),
    )  # fmt: skip
    for file in files:
        if not file.is_file():
            there = "is a pipe or a device" if file.exists() else "does not exist"
            what = "is a folder" if file.is_dir() else there
            hint = similar_file(file) or "; check the name"
            raise DataError(f"{file} {what}, but a data file was expected, such as CSV{hint}")
    if config.data.sheet is not None:
        from atoll_coordinator.data.reading.typed_formats import check_sheet

        check_sheet(files, config.data.sheet)
    return request


def config_of(options: argparse.Namespace) -> JobConfig:
    """Return the configuration that the options of ``run`` or ``submit`` describe; raises UsageError."""
    given = {name: getattr(options, name) for name in OPTIONS}
    values = {name: Repeated(value) if isinstance(value, list) else value for name, value in given.items()}
    return configure(values, options.config)


def is_saved(name: str, options: argparse.Namespace) -> bool:
    """Return whether `name` is a saved result; if not, it is the id of a job of the given coordinator."""
    from atoll_coordinator.result.reading import RESULT

    is_connected = bool(options.connect or os.environ.get("ATOLL_CONNECT"))
    return not is_connected or not is_id(name) or (Path(name) / RESULT).is_file()


def load_result(name: str) -> "Result":
    """Return a saved result; raises UsageError if there is no such file (`name` may be the id of a job)."""
    from atoll_coordinator.result.result import Result

    if is_id(name) and not Path(name).exists():
        found_nothing = f"{name} is not a saved result, and no coordinator with a job of this id was given"
        raise UsageError(f"{found_nothing}; give PATH/result.json, or --connect tcp/HOST:PORT")
    return Result.load(name)


def result_of(name: str, options: argparse.Namespace) -> "Result":
    """Return a saved result, or the result of a coordinator's job; for a running job, the best so far.

    Raises:
        UsageError: there is no such file, or it is not a result.
        RefusedError: there is no such job, or it has no result yet.
        UnreachableError: no coordinator answers.
    """
    from atoll_coordinator.result.result import Result

    if is_saved(name, options):
        return load_result(name)
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        return Result.of(client.result(client.resolve(name)))


def address_of(options: argparse.Namespace) -> Whereabouts:
    """Return the address of the coordinator, from ``--connect``, ``--tls-*`` or the environment; raises UsageError."""
    address = options.connect or os.environ.get("ATOLL_CONNECT")
    if options.connect and "token=" in options.connect:
        note(f"coordinator: other users of this machine can read the token on the command line; give it in {TOKEN}")
    if not address:
        raise UsageError("no coordinator was named; give --connect tcp/HOST:PORT or set ATOLL_CONNECT")
    return coordinator_at(address, vars(options), os.environ)


def bus_address_of(options: argparse.Namespace) -> Destination:
    """Return the address of the coordinator on the bus; raises UsageError for an HTTP address."""
    address = address_of(options)
    if not isinstance(address, Destination):
        raise UsageError(
            f"{address} is an HTTP address, but this command needs an address on the bus, such as tcp/HOST:PORT"
        )
    return address
