"""The command line: one table (`VERBS`) with the module, help and arguments of every verb, its parser, and functions
that convert values which argparse does not convert.

It has only light imports, because ``--help`` must be instant. `atoll.client.job_options` declares the options of a job.
"""

import argparse
import math
import re
import uuid
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NoReturn, TypeVar

from atoll.client.job_options import GROUPS, MOST_WORKERS
from atoll_core.command_line import (
    SHELLS,
    Parser,
    add_log_options,
    add_tls_options,
    complete,
    duration,
    seconds,
    whole_number,
)
from atoll_core.errors import UsageError
from atoll_core.wire.topics import is_id

T = TypeVar("T")


def job_id(text: str | None) -> str:
    """Return the id of ``--id``, or a new random id if `text` is None."""
    if text is None:
        return uuid.uuid4().hex[:8]
    if not is_id(text):
        raise UsageError(f"--id must be 1 to 64 letters, digits, _ or -, but {text!r} was given")
    return text


def finite_number(text: str, option: str) -> float:
    """Return the number; raises UsageError, like the functions below."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"{option} must be a finite number, but {text!r} was given")
    return value


def natural_number(text: str, option: str) -> int:
    """Return a whole number, 0 or more."""
    if not text.isdecimal():
        raise UsageError(f"{option} must be a whole number, but {text!r} was given")
    return int(text)


def if_given(read: Callable[[str, str], T], text: str | None, option: str) -> T | None:
    """Return the value of an option as `read` parses it; None if the option was not given."""
    return None if text is None else read(text, option)


def interval(text: str, option: str) -> tuple[float, float]:
    """Return the lower and the upper bound of a text such as ``0:3``."""
    lower, separator, upper = text.partition(":")
    if not separator:
        raise UsageError(f"{option} must be LOWER:UPPER, but {text!r} was given")
    low, high = finite_number(lower, option), finite_number(upper, option)
    if not low < high:
        raise UsageError(f"{option} must have LOWER below UPPER, but {text!r} was given")
    return low, high


def assignments(texts: Sequence[str], option: str, example: str) -> dict[str, str]:
    """Return the values by name from texts such as ``x=0:3``; one text may hold several, separated by commas."""
    values: dict[str, str] = {}
    for text in (part for line in texts for part in line.split(",")):
        name, separator, value = (part.strip() for part in text.partition("="))
        if not separator or not name or not value:
            raise UsageError(f"{option} must be {example}, but {text!r} was given")
        if name in values:
            raise UsageError(f"{option} names '{name}' twice; give one value for each name")
        values[name] = value
    return values


def numbers(texts: Sequence[str], option: str, example: str) -> dict[str, float]:
    """Return the numbers by name from texts such as ``u=1``."""
    return {name: finite_number(text, f"{option} {name}") for name, text in assignments(texts, option, example).items()}


def intervals(texts: Sequence[str], option: str) -> dict[str, tuple[float, float]]:
    """Return the bounds by name from texts such as ``x=0:3``."""
    values = assignments(texts, option, "NAME=LOWER:UPPER")
    return {name: interval(text, f"{option} {name}") for name, text in values.items()}


EXPORT_FORMATS: Final = (
    "python", "c", "julia", "matlab", "modelica", "xppaut", "sbml", "latex", "sympy", "csv", "json", "petab"
)  # fmt: skip
BATCH_SYSTEMS: Final = ("slurm", "pbs", "lsf", "sge")
_RESULT_FORMATS: Final = ("text", "json", "csv", "sympy", "latex")
_AGES: Final = {"s": 1, "m": 60, "h": 3600, "d": 86400}
_SIZES: Final = {"M": 10**6, "G": 10**9, "T": 10**12}

Add = Callable[[argparse.ArgumentParser], object]
"""A function that adds one or several arguments to the parser of a verb."""


def _value(flag: str, metavar: str | None, text: str, **settings: Any) -> Add:
    return lambda parser: parser.add_argument(flag, metavar=metavar, help=text, **settings)


def _repeatable(flag: str, metavar: str, text: str) -> Add:
    return _value(flag, metavar, f"{text}; repeatable", action="append", default=[])


def _switch(flag: str, text: str) -> Add:
    return lambda parser: parser.add_argument(flag, action="store_true", help=text)


def _output(text: str) -> Add:
    return lambda parser: parser.add_argument("-o", "--output", metavar="FILE", help=text)


def _either(*arguments: Add) -> Add:
    """Add mutually exclusive arguments."""

    def add(parser: argparse.ArgumentParser) -> None:
        group: Any = parser.add_mutually_exclusive_group()
        for add_argument in arguments:
            add_argument(group)

    return add


def _job_options(heading: str) -> Add:
    """Add the options of a job under `heading` in the table of options."""

    def add(parser: argparse.ArgumentParser) -> None:
        group: Any = parser.add_argument_group(heading)
        for option in GROUPS[heading]:
            if option.metavar is None:
                _switch(option.flag, option.help)(group)
            elif option.is_repeatable:
                _value(option.flag, option.metavar, f"{option.help}; repeatable", action="append")(group)
            else:
                _value(option.flag, option.metavar, option.help)(group)

    return add


def _host_and_port(text: str) -> tuple[str, int]:
    """Return host and port of ``127.0.0.1:9464``, or of ``:9464`` on this machine only."""
    host, colon, port = text.strip().rpartition(":")
    if not (colon and re.fullmatch("[0-9]{1,5}", port) and 0 < int(port) < 65536):
        raise argparse.ArgumentTypeError(f"HOST:PORT such as 127.0.0.1:9464 was expected, but {text!r} was given")
    return host.strip("[]") or "127.0.0.1", int(port)


def _keep(text: str) -> tuple[int | None, int | None]:
    """Return the seconds and bytes of a text such as ``90d,8G``, None for an omitted part; raises ArgumentTypeError."""
    if text == "all":
        return None, None
    limits: dict[str, int] = {}
    for part in text.split(","):
        match = re.fullmatch("([1-9][0-9]{0,5})([smhdMGT])", part)
        kind = "age" if match and match[2] in _AGES else "size"
        if match is None or kind in limits:
            raise argparse.ArgumentTypeError(
                f"an age such as 90d, a size such as 8G, both as 90d,8G, or all was expected, but {text!r} was given"
            )
        limits[kind] = int(match[1]) * (_AGES | _SIZES)[match[2]]
    return limits.get("age"), limits.get("size")


_JSON: Final = _switch("--json", "print JSON")
_CONNECT: Final = (
    _value(
        "--connect", "tcp/HOST:PORT",
        "address of the coordinator, or several addresses separated by commas (default: $ATOLL_CONNECT)",
    ),
    add_tls_options,
)  # fmt: skip
_LISTEN: Final = _value(
    "--listen", "tcp/HOST:PORT", default="tcp/127.0.0.1:7447",
    text="where workers and clients connect; tcp/0.0.0.0:7447 for every network (default: %(default)s)",
)  # fmt: skip
_STATE: Final = _value(
    "--state", "DIR", "folder of the job store (default: %(default)s)", default="atoll-state"
)  # fmt: skip
_SERVICE: Final = (
    _value(
        "--connect-file", "FILE",
        "write the addresses for workers and clients into this file when ready; for island-worker --connect-file",
    ),
    add_tls_options,
    _value("--roster", "FILE", 'roles of the names in certificates (TOML: lab1 = "worker")'),
    add_log_options,
)  # fmt: skip
_JOB: Final = (
    _value("data", "DATA", "data files: CSV and other text, Excel, MATLAB, HDF5, Parquet, NPZ, JSON", nargs="+"),
    _switch("--json", "print the result as JSON"),
    _switch("--report", "also write the result as a page, report.html"),
    _value("--name", "NAME", "a label for lists of jobs (default: the first file's name)"),
    _value("--id", "ID", "the job's id (default: random)"),
    _value("--config", "job.toml", "a file with settings of the job; options override these settings"),
    _switch("--dry-run", "show how the data are read and the plan of the search; start nothing"),
    *(_job_options(heading) for heading in GROUPS),
)

_RESULT: Final = _value("result", "RESULT", "PATH/result.json, its folder, or the id of a job of a coordinator")
_GROUP: Final = _value("--group", "NAME", "use the constants of this group of trajectories")
_UNTIL: Final = _value("--until", "T", "last time (default: last time of the first trajectory, or of the file)")
_HOLD: Final = _repeatable("--hold", "u=1", "value of an input (default: 0)")
_PICK: Final = _repeatable("--pick", "x=2", "use equation 2 of the front of x")
_DATA: Final = _value(
    "--data", "DATA", "measurements to use in place of the data in the result", nargs="+"
)  # fmt: skip
_PICTURE: Final = _value("--picture", "FILE", "also draw the bands into this SVG file")
_OUTPUT: Final = _output("write to this file (default: stdout)")


def _of_coordinator(subject: str, nargs: str | None = "?") -> Sequence[Add]:
    """Return the arguments of a verb for a job or worker of a coordinator; `subject` is the help of this argument."""
    return _value("job", "ID", subject, nargs=nargs), *_CONNECT, _JSON


_ONE_JOB: Final = _of_coordinator("id or its beginning", nargs=None)
_WORKER: Final = _of_coordinator("name or its beginning", nargs=None)

VERBS: Final[Mapping[str, tuple[str, str, Sequence[Add]]]] = {
    "run": ("verbs.run", "search on this machine, without a running coordinator", (
        *_JOB,
        _value(
            "--web", "HOST:PORT", "show the job in a browser while it runs (default: 127.0.0.1:7480)",
            nargs="?", const=("127.0.0.1", 7480), type=_host_and_port,
        ),
        _value(
            "--workers", "N", "worker processes (default: one per core this process may use)",
            type=whole_number(1, MOST_WORKERS),
        ),
        _value("--out", "DIR", "folder for result.json and the log (default: runs/JOB)"),
    )),
    "serve": ("verbs.serve", "run the coordinator for workers and jobs of any machine", (
        _either(
            _LISTEN,
            _value(
                "--router", "tcp/HOST:PORT",
                "do not listen; join the router (coordinator router, or zenohd) at this address, as workers do",
            ),
        ),
        _STATE,
        _value(
            "--keep", "AGE,SIZE", type=_keep, default="90d,8G",
            text="keep ended jobs for this time (30m, 12h, 90d) and up to this total size (500M, 8G); beyond these "
            "limits, the oldest jobs are deleted; one of the limits may be left out; `all` keeps all jobs (default: "
            "%(default)s)",
        ),
        _switch(
            "--standby",
            "wait while another coordinator serves the same --state; take over when that coordinator ends or hangs",
        ),
        _value(
            "--metrics", "HOST:PORT", "serve metrics for Prometheus here, such as 127.0.0.1:9464 (default: no metrics)",
            type=_host_and_port,
        ),
        _value(
            "--http", "HOST:PORT", "also start coordinator web here, such as 127.0.0.1:7480 (default: not started)",
            type=_host_and_port,
        ),
        _value("--http-users", "FILE", "like --users of coordinator web; required if --http and --roster are given"),
        *_SERVICE,
        _value("--limits", "FILE", "limits of users (TOML); SIGHUP makes serve read this file and --roster again"),
        _value(
            "--wait", "SECONDS", "how long to wait for --router (default: %(default)g)",
            type=seconds, default=10.0,
        ),
    )),
    "web": ("verbs.web", "show a coordinator in a browser, and answer its API over HTTP", (
        *_CONNECT,
        _value(
            "--listen", "HOST:PORT", default=("127.0.0.1", 7480), type=_host_and_port,
            text="where browsers connect (default: 127.0.0.1:7480); other machines need --cert and --key",
        ),
        _repeatable("--allow-host", "NAME", "another allowed host name for browsers, such as the name of a proxy"),
        _value("--cert", "FILE", "certificate for HTTPS; required for browsers on other machines"),
        _value("--key", "FILE", "key of the certificate"),
        _value("--users", "FILE", "tokens of users, each with a certificate for the coordinator (TOML; docs/web.md)"),
        _switch("--look-without-token", "let all programs of this machine see all jobs without a token"),
    )),
    "backup": ("verbs.serve", "copy a coordinator's job store into a file, also while it is served", (
        _value("file", "FILE", "the copy; it must not exist yet"), _STATE, _JSON,
    )),
    "restore": ("verbs.serve", "make a job store from a copy; no coordinator may serve it", (
        _value("file", "FILE", "the file that backup has written"),
        _STATE,
        _switch("--replace", "move an existing store aside"),
        _JSON,
    )),
    "router": ("verbs.serve", "forward messages, for another site or to keep connections open while serve restarts", (
        _LISTEN,
        _repeatable(
            "--connect", "tcp/HOST:PORT",
            "the router or coordinator to which messages for other sites go",
        ),
        *_SERVICE,
    )),
    "adapt": ("adapt", "start and end batch jobs with workers, as the coordinator's queue needs them", (
        *_CONNECT,
        _value(
            "--minimum", "N", "smallest number of jobs (default: %(default)s)",
            type=whole_number(0, 10**6 - 1), default=0,
        ),
        _value("--maximum", "N", "largest number of jobs", type=whole_number(0, 10**6 - 1), required=True),
        _value(
            "--cores", "N", "cores of each job, with one worker per core (default: %(default)s)",
            type=whole_number(1, MOST_WORKERS), default=1,
        ),
        _value("--batch", None, "the batch system (default: slurm)", choices=BATCH_SYSTEMS, default="slurm"),
        _value("--sbatch", "OPTIONS", 'more options for sbatch, such as --sbatch="--partition=idle --time=2:00:00"'),
        _value(
            "--batch-options", "OPTIONS",
            'more options for any batch system, such as --batch pbs --batch-options="-q idle"',
        ),
        _value(
            "--worker", "COMMAND",
            "command that starts the workers of a job, such as 'apptainer exec atoll.sif island-worker' (default: the "
            "island-worker next to this program)",
        ),
        _value(
            "--idle", "TIME", type=duration, default=300.0,
            text="drain a job when fewer jobs have sufficed for this time (default: 5m)",
        ),
        _value(
            "--interval", "TIME", "time between two checks (default: 15s)", type=duration, default=15.0
        ),
        _value(
            "--wait", "SECONDS", "how long coordinator or batch system may be unreachable (default: %(default)g)",
            type=seconds, default=600.0,
        ),
        add_log_options,
    )),
    "submit": ("verbs.submit", "submit a job to a coordinator and follow it; Ctrl-C detaches, the job continues", (
        *_CONNECT,
        *_JOB,
        _switch("--no-wait", "print only the job id, and return"),
        _value("--out", "DIR", "also write result.json into this folder"),
        _value(
            "--priority", "N", type=whole_number(-10, 10), default=0,
            text="-10 to 10; among your own jobs, each step doubles the job's share of the workers, and the job starts "
            "sooner (default: 0)",
        ),
        _switch("--share", "make the job visible to all users of the coordinator, not only to you and admins"),
    )),
    "ping": ("verbs.jobs", "test whether a coordinator answers, for probes; exit code 3 if it does not", (
        *_CONNECT,
        _JSON,
        _value("--wait", "SECONDS", "how long to wait for an answer (default: %(default)g)", type=seconds, default=5.0),
    )),
    "jobs": ("verbs.jobs", "list the jobs of a coordinator", (
        *_of_coordinator("only jobs with ids that begin with this text"),
        _value("--last", "N", "only the N newest jobs (default: all)", type=whole_number(1, 10**9)),
    )),
    "status": ("verbs.jobs", "show the progress of a job", (
        *_of_coordinator("id or its beginning (default: all jobs that have not ended)"),
        _switch("--follow", "continue until the job has ended; return its exit code"),
    )),
    "workers": ("verbs.jobs", "list the workers of a coordinator", (
        *_of_coordinator("only workers with names that begin with this text"),
        _switch("--coordinator", "show the coordinator's own counters"),
    )),
    "result": ("verbs.results", "print the equations of a job; for a running job, the best equations so far", (
        *_of_coordinator("id or its beginning, or PATH/result.json", nargs=None),
        _value("--format", None, "form of the output (default: text)", choices=_RESULT_FORMATS),
        _PICK,
    )),
    "cancel": (
        "verbs.jobs", "end a job and keep its best equations",
        _of_coordinator("id or its beginning (default: the only job that has not ended)"),
    ),
    "delete": (
        "verbs.jobs", "delete a job that has ended, with its result and its data",
        _ONE_JOB,
    ),
    "pause": (
        "verbs.jobs", "stop a job at a checkpoint until it is resumed; it keeps its position in the queue",
        _ONE_JOB,
    ),
    "resume": ("verbs.jobs", "continue a paused job", _ONE_JOB),
    "priority": ("verbs.jobs", "give a job another priority", (
        *_ONE_JOB,
        _value("priority", "N", "-10 to 10", type=whole_number(-10, 10)),
    )),
    "share": ("verbs.jobs", "make a job visible to all users", (
        *_ONE_JOB,
        _switch("--private", "make it visible only to its submitter and admins"),
    )),
    "retry": ("verbs.jobs", "submit a failed or cancelled job again; prints the id of the new job", (
        *_ONE_JOB,
        _value("--id", "ID", "the new job's id (default: random)"),
    )),
    "logs": ("verbs.jobs", "show the event log of a job", (
        *_of_coordinator("id or its beginning (default: events of all jobs and workers)"),
        _switch("--follow", "continue until the job has ended"),
        _switch("--workers", "only log lines of workers"),
        _value(
            "--level", "LEVEL", "only events of this level or above: info, warning, error (default: %(default)s)",
            choices=("info", "warning", "error"), default="info",
        ),
        _value("--lines", "N", "at most the N last events (default: 200)", type=whole_number(1, 1000), default=200),
    )),
    "cordon": ("verbs.jobs", "place no more islands on a worker (admins)", _WORKER),
    "uncordon": ("verbs.jobs", "place islands on a worker again (admins)", _WORKER),
    "drain": ("verbs.jobs", "move the islands of a worker to other workers, and place no more on it (admins)", _WORKER),
    "queue": ("verbs.jobs", "show how many jobs wait; pause or resume the start of jobs (admins)", (
        _value("change", None, "pause or resume (default: show the queue)", nargs="?", choices=("pause", "resume")),
        *_CONNECT,
        _JSON,
    )),
    "simulate": ("verbs.results", "simulate the model of a result from any initial state; write CSV with bands", (
        _RESULT,
        *_CONNECT,
        _value(
            "--initial", "x=1,y=3|FILE",
            "initial state; or a data file with initial state, times and inputs (default: as measured)",
        ),
        _GROUP,
        _UNTIL,
        _value("--step", "DT", "time step (default: 500 steps in total)"),
        _repeatable("--hold", "u=1", "value of an input (default: as measured)"),
        _value(
            "--paths", "N",
            "for a stochastic process: draw N paths and write mean, median, 5 %% and 95 %% quantiles",
        ),
        _value("--seed", "S", "random seed of the paths (default: 0)"),
        _switch("--each-path", "write every path instead of quantiles, with a column `trajectory`"),
        _OUTPUT,
        _switch("--json", "write JSON: status, message, columns"),
    )),
    "smooth": ("verbs.results", "estimate the states along each trajectory under the law of a result, with bands", (
        _RESULT,
        *_CONNECT,
        _GROUP,
        _DATA,
        _PICTURE,
        _OUTPUT,
        _switch("--json", "write JSON"),
    )),
    "forecast": ("verbs.results", "forecast the states after the last row, with bands and a horizon", (
        _RESULT,
        *_CONNECT,
        _value("--for", "T", "length of the forecast, in units of time", required=True, dest="duration"),
        _GROUP,
        _value(
            "--data", "DATA", "measurements whose last row begins the forecast (default: the data in the result)",
            nargs="+",
        ),
        _value("--trajectory", "NAME", "forecast this trajectory (default: the last one)"),
        _value("--inputs", "FILE", "inputs after the last row (default: each input keeps its last value)"),
        _value("--step", "DT", "time step (default: 200 steps)"),
        _value("--draws", "N", "number of draws (default: 1000)", default="1000"),
        _value("--seed", "S", "random seed of the draws (default: 0)", default="0"),
        _switch("--no-rivals", "draw only the displayed equations, and no alternative systems"),
        _PICTURE,
        _OUTPUT,
        _switch("--json", "write JSON"),
    )),
    "analyse": ("verbs.results", "fixed points, limit cycles, basins and bifurcations of the model of a result", (
        _RESULT,
        *_CONNECT,
        _repeatable(
            "--box", "x=0:3",
            "bounds of a state (default: the measured range, extended on each side by half of its width)",
        ),
        _GROUP,
        _HOLD,
        _switch("--identifiability", "show which constants the data determine, by profile likelihood"),
        _DATA,
        _value(
            "--parameter", "c1",
            "parameter to vary: a constant, several constants in a fixed ratio (c1,c2), a coefficient (y:x*y in dy/dt),"
            " or an input",
        ),
        _value("--range", "A:B", "range of --parameter"),
        _OUTPUT,
        _switch("--json", "write JSON, with all curves"),
    )),
    "report": ("verbs.results", "write a result as one HTML page without scripts or external resources", (
        _value("result", "RESULT", "one or more results: PATH/result.json, its folder, or the id of a job", nargs="+"),
        *_CONNECT,
        _GROUP,
        _output("the page (default: report.html next to the result)"),
        _value("--pictures", "DIR", "also write every picture as an SVG file"),
    )),
    "suggest": ("verbs.results", "propose the next experiment: where the candidates of a result differ most", (
        _RESULT,
        *_CONNECT,
        _GROUP,
        _repeatable(
            "--box", "x=0:3", "bounds of an initial state or of a constant input (default: the range of the data)"
        ),
        _value("--duration", "T", "duration of an experiment (default: duration of the median trajectory)"),
        _value("--samples", "N", "number of measurements of each state (default: as in the median trajectory)"),
        _value(
            "--cost", "trajectory|duration|samples", default="trajectory",
            text="cost of an experiment: equal for all, its duration, or its number of samples (default: trajectory)",
        ),
        _value("--count", "N", "number of experiments (default: 3)", default="3"),
        _repeatable(
            "--rival", "dx=EXPR",
            "the equations of an alternative system, separated by ';'; their constants are fitted",
        ),
        _value("--seed", "S", "random seed for the trial experiments (default: 0)", default="0"),
        _DATA,
        _OUTPUT,
        _switch("--json", "write JSON, with all times"),
    )),
    "compare": ("verbs.results", "tell which of two results or candidates fits the data better, and with which odds", (
        _value("first", "A", "PATH/result.json, its folder or the id of a job; append :N for candidate N (1: best)"),
        _value("second", "B", "another result, or :N for a candidate of the same result"),
        *_CONNECT,
        _GROUP,
        _DATA,
        _OUTPUT,
        _switch("--json", "write JSON"),
    )),
    "export": ("verbs.results", "write the model of a result for other programs", (
        _RESULT,
        *_CONNECT,
        _GROUP,
        _value("--format", None, "output format; see docs/export.md", required=True, choices=EXPORT_FORMATS),
        _output("write to this file (default: stdout); for petab, to this folder"),
        _PICK,
        _value(
            "--candidate", "N", "use candidate N of the result (1: the best)", type=whole_number(1, 1000)
        ),
        _value(
            "--initial", "x=1,y=3|FILE", "initial state, times and inputs, as for simulate (default: as measured)"
        ),
        _UNTIL,
        _value("--step", "DT", "time step"),
        _HOLD,
        _DATA,
    )),
    "doctor": ("doctor", "check this machine, a coordinator and data files, and print advice; exit code 1: problems", (
        _value("data", "DATA", "data files to read as submit does", nargs="*"),
        _value("--connect", "tcp/HOST:PORT", "the coordinator to check (default: $ATOLL_CONNECT, if set)"),
        _value("--listen", "tcp/HOST:PORT", "check that a coordinator could listen at this address"),
        _value("--state", "DIR", "the folder of a coordinator's job store (default: the current folder)"),
        _switch("--quick", "only check that the coordinator's address accepts connections"),
        _JSON,
        add_tls_options,
        _job_options("data"),
    )),
    "schema": (
        "verbs.texts", "print the JSON schema of a --config file or of a result file",
        (_value("file", None, "default: config", nargs="?", choices=("config", "result"), default="config"),),
    ),
    "completion": (
        "verbs.texts", "print shell code for the completion of commands and options",
        (_value("shell", None, "the shell that runs this code", choices=SHELLS),),
    ),
}  # fmt: skip
"""For each verb its module in `atoll.cli`, a line of help and its arguments, in the order of the help. The module has a
function with the name of the verb, which takes the parsed options and returns the exit code.
"""


EXIT_CODES: Final = (
    "exit codes: 0 done, 1 job failed or a temporary error (full disk, address in use), 2 bad usage or bad data,\n"
    "3 coordinator not reachable, 4 an explicit --target-error was not met within the budget,\n"
    "130 detached or interrupted"
)


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """Return the parsed options; `verb` is one of `VERBS`.

    Raises UsageError if an option or verb is unknown or incomplete, SystemExit after ``--help`` or ``--version``.
    """
    parser = build_parser()
    complete(parser)
    # argparse treats values with a leading minus as options, so ``--operators -,+`` and ``--range -1:1`` become one
    # word
    words: list[str] = []
    for word in argv:
        is_list = words[-1:] == ["--operators"] and (word == "-" or word.startswith("-,"))
        is_number = words[-1:] == ["--range"] and word[:1] == "-" and word[1:2] in tuple("0123456789.")
        if is_list or is_number:
            words[-1] = f"{words[-1]}={word}"
        else:
            words.append(word)
    options = parser.parse_args(words)
    if options.verb is None:
        raise UsageError(f"no command was given, expected one of {', '.join(VERBS)}; see coordinator --help")
    return options


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    parser = Parser(
        prog="coordinator",
        description="Atoll finds the differential equations behind measured trajectories.",
        epilog=EXIT_CODES,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version and exit")
    commands = parser.add_subparsers(dest="verb", metavar="COMMAND", title="commands")
    for name, (_, text, arguments) in VERBS.items():
        verb = commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.", epilog=EXIT_CODES)
        for add in arguments:
            add(verb)
    return parser


class _Version(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from atoll_core import PROTOCOL_VERSION, VERSION

        parser._print_message(f"coordinator {VERSION} (protocol {PROTOCOL_VERSION})\n")
        parser.exit()
