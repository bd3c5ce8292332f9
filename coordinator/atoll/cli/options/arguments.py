"""The verbs with their arguments, in one table. Standard library only, because ``--help`` must be instant."""

import argparse
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from atoll.client.options import GROUPS, MOST_WORKERS
from atoll_core.command_line import SHELLS, add_log_options, add_tls_options, duration, seconds, whole_number

EXPORT_FORMATS: Final = (
    "python", "c", "julia", "matlab", "modelica", "xppaut", "sbml", "latex", "sympy", "csv", "json", "petab"
)  # fmt: skip
BATCH_SYSTEMS: Final = ("slurm", "pbs", "lsf", "sge")
_RESULT_FORMATS: Final = ("text", "json", "csv", "sympy", "latex")
_AGES: Final = {"s": 1, "m": 60, "h": 3600, "d": 86400}
_SIZES: Final = {"M": 10**6, "G": 10**9, "T": 10**12}

Add = Callable[[argparse.ArgumentParser], object]
"""Adds an argument, or several, to the parser of a verb."""


def _value(flag: str, metavar: str | None, text: str, **settings: Any) -> Add:
    return lambda parser: parser.add_argument(flag, metavar=metavar, help=text, **settings)


def _repeatable(flag: str, metavar: str, text: str) -> Add:
    return _value(flag, metavar, f"{text}; repeatable", action="append", default=[])


def _switch(flag: str, text: str) -> Add:
    return lambda parser: parser.add_argument(flag, action="store_true", help=text)


def _output(text: str) -> Add:
    return lambda parser: parser.add_argument("-o", "--output", metavar="FILE", help=text)


def _either(*arguments: Add) -> Add:
    """Add arguments that exclude each other."""

    def add(parser: argparse.ArgumentParser) -> None:
        group: Any = parser.add_mutually_exclusive_group()
        for add_argument in arguments:
            add_argument(group)

    return add


def _job_options(heading: str) -> Add:
    """Add the options of a job that stand under this heading of their table."""

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
    """Return host and port of ``127.0.0.1:9464``, or of ``:9464`` on this machine alone."""
    host, colon, port = text.strip().rpartition(":")
    if not (colon and re.fullmatch("[0-9]{1,5}", port) and 0 < int(port) < 65536):
        raise argparse.ArgumentTypeError(f"HOST:PORT such as 127.0.0.1:9464 was expected, but {text!r} was given")
    return host.strip("[]") or "127.0.0.1", int(port)


def _keep(text: str) -> tuple[int | None, int | None]:
    """Return seconds and bytes of ``90d,8G``, None for what is left out; raises ArgumentTypeError."""
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
        "--connect", "tcp/HOST:PORT", "the coordinator, at one or several addresses, as a,b (default: $ATOLL_CONNECT)",
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
        "write the addresses to connect to there, once they can be connected to; for island-worker --connect-file",
    ),
    add_tls_options,
    _value("--roster", "FILE", 'who may do what, by the names in certificates (TOML: lab1 = "worker")'),
    add_log_options,
)  # fmt: skip
_JOB: Final = (
    _value("data", "DATA", "data files: CSV and other text, Excel, MATLAB, HDF5, Parquet, NPZ, JSON", nargs="+"),
    _switch("--json", "print the result as JSON"),
    _switch("--report", "also write the result as a page, report.html"),
    _value("--name", "NAME", "a label for lists (default: the first file's name)"),
    _value("--id", "ID", "the job's id (default: made up)"),
    _value("--config", "job.toml", "the same settings as a file; options override it"),
    _switch("--dry-run", "say how the data are read and what would be searched; start nothing"),
    *(_job_options(heading) for heading in GROUPS),
)

_RESULT: Final = _value("result", "RESULT", "PATH/result.json, its folder, or the id of a job of a coordinator")
_GROUP: Final = _value("--group", "NAME", "the group of trajectories whose constants are taken, if any")
_UNTIL: Final = _value("--until", "T", "last time (default: that of the first trajectory, or the file's)")
_HOLD: Final = _repeatable("--hold", "u=1", "value of an input (default: 0)")
_PICK: Final = _repeatable("--pick", "x=2", "take number 2 of the front of x")
_DATA: Final = _value(
    "--data", "DATA", "measurements to use in the place of those that the result has", nargs="+"
)  # fmt: skip
_OUTPUT: Final = _output("write to this file (default: stdout)")


def _of_coordinator(subject: str, nargs: str | None = "?") -> Sequence[Add]:
    """Return the arguments of a verb that asks a coordinator about `subject`."""
    return _value("job", "ID", subject, nargs=nargs), *_CONNECT, _JSON


VERBS: Final[Mapping[str, tuple[str, Sequence[Add]]]] = {
    "run": ("search on this machine; nothing needs to be started beforehand", (
        *_JOB,
        _value(
            "--web", "HOST:PORT", "show the job in a browser while it runs (default: 127.0.0.1:7480)",
            nargs="?", const=("127.0.0.1", 7480), type=_host_and_port,
        ),
        _value(
            "--workers", "N", "worker processes (default: one per core this process may use)",
            type=whole_number(1, MOST_WORKERS),
        ),
        _value("--out", "DIR", "folder of result.json and the log (default: runs/JOB)"),
    )),
    "serve": ("run the coordinator for workers and jobs of any machine", (
        _either(
            _LISTEN,
            _value(
                "--router", "tcp/HOST:PORT",
                "do not listen, but join a router there (coordinator router, or zenohd), as workers and clients do",
            ),
        ),
        _STATE,
        _value(
            "--keep", "AGE,SIZE", type=_keep, default="90d,8G",
            text="delete ended jobs, the oldest first, that ended longer ago (30m, 12h, 90d) or while ended ones take "
            "more (500M, 8G); one of the two may be left out, and `all` keeps all (default: %(default)s)",
        ),
        _switch(
            "--standby",
            "wait while another coordinator serves the same --state, and take over when it has died or hangs",
        ),
        _value(
            "--metrics", "HOST:PORT", "answer Prometheus there over HTTP, such as 127.0.0.1:9464 (default: nowhere)",
            type=_host_and_port,
        ),
        _value(
            "--http", "HOST:PORT", "also start coordinator web there, such as 127.0.0.1:7480 (default: nowhere)",
            type=_host_and_port,
        ),
        _value("--http-users", "FILE", "as --users of coordinator web; --http needs it where there is a --roster"),
        *_SERVICE,
        _value("--limits", "FILE", "how much users may have (TOML; read again, as --roster is, at a SIGHUP)"),
        _value(
            "--wait", "SECONDS", "how long --router may take to be there (default: %(default)g)",
            type=seconds, default=10.0,
        ),
    )),
    "web": ("show a coordinator in a browser, and answer its API over HTTP", (
        *_CONNECT,
        _value(
            "--listen", "HOST:PORT", default=("127.0.0.1", 7480), type=_host_and_port,
            text="where browsers connect (default: 127.0.0.1:7480); beyond this machine with --cert and --key alone",
        ),
        _repeatable("--allow-host", "NAME", "a further name under which browsers find it, such as that of a proxy"),
        _value("--cert", "FILE", "certificate for HTTPS, which beyond this machine is needed"),
        _value("--key", "FILE", "its key"),
        _value("--users", "FILE", "tokens of users, each with a certificate for the coordinator (TOML; docs/web.md)"),
        _switch("--look-without-token", "let all programs of this machine look at all jobs, without a token"),
    )),
    "backup": ("copy a coordinator's job store into a file, also while it is served", (
        _value("file", "FILE", "the copy; it must not exist yet"), _STATE, _JSON,
    )),
    "restore": ("make a job store of a copy; no coordinator may serve it", (
        _value("file", "FILE", "the copy that backup has written"),
        _STATE,
        _switch("--replace", "put a store that is there aside"),
        _JSON,
    )),
    "router": ("pass messages on: for a site of its own, or to keep connections while serve restarts", (
        _LISTEN,
        _repeatable(
            "--connect", "tcp/HOST:PORT",
            "the router, or the coordinator, to which this one passes on what is not for its site",
        ),
        *_SERVICE,
    )),
    "adapt": ("keep as many jobs of a batch system with workers as the coordinator's queue has work for", (
        *_CONNECT,
        _value(
            "--minimum", "N", "jobs at least (default: %(default)s)", type=whole_number(0, 10**6 - 1), default=0
        ),
        _value("--maximum", "N", "jobs at most", type=whole_number(0, 10**6 - 1), required=True),
        _value(
            "--cores", "N", "cores, and so workers, of each (default: %(default)s)",
            type=whole_number(1, MOST_WORKERS), default=1,
        ),
        _value("--batch", None, "the batch system (default: slurm)", choices=BATCH_SYSTEMS, default="slurm"),
        _value("--sbatch", "OPTIONS", 'further options of sbatch, as --sbatch="--partition=idle --time=2:00:00"'),
        _value(
            "--batch-options", "OPTIONS",
            'the same of any system\'s program that submits, as --batch pbs --batch-options="-q idle"',
        ),
        _value(
            "--worker", "COMMAND",
            "how a job starts its workers, such as 'apptainer exec atoll.sif island-worker' (default: the "
            "island-worker beside this program)",
        ),
        _value(
            "--idle", "TIME", type=duration, default=300.0,
            text="how long fewer jobs must be enough before one is drained (default: 5m)",
        ),
        _value(
            "--interval", "TIME", "from one look to the next (default: 15s)", type=duration, default=15.0
        ),
        _value(
            "--wait", "SECONDS", "how long coordinator or batch system may be away (default: %(default)g)",
            type=seconds, default=600.0,
        ),
        add_log_options,
    )),
    "submit": ("give a job to a coordinator and follow it; Ctrl-C detaches, the job goes on", (
        *_CONNECT,
        *_JOB,
        _switch("--no-wait", "print the job id, and nothing else, and return"),
        _value("--out", "DIR", "also write result.json into this folder"),
        _value(
            "--priority", "N", type=whole_number(-10, 10), default=0,
            text="-10 to 10; among your own jobs each step doubles its share of the workers, and it is taken up sooner "
            "(default: 0)",
        ),
        _switch("--share", "let everybody see the job who may use the coordinator, not only you and admins"),
    )),
    "ping": ("ask whether a coordinator answers, as probes do; 3: it does not", (
        *_CONNECT,
        _JSON,
        _value("--wait", "SECONDS", "how long to wait for it (default: %(default)g)", type=seconds, default=5.0),
    )),
    "jobs": ("list the jobs of a coordinator", (
        *_of_coordinator("only jobs whose id begins with this"),
        _value("--last", "N", "only the N that came last (default: all)", type=whole_number(1, 10**9)),
    )),
    "status": ("show how far a job has come", (
        *_of_coordinator("id or its beginning (default: every job that has not ended)"),
        _switch("--follow", "go on until the job has ended, with its exit code"),
    )),
    "workers": ("list the workers of a coordinator", (
        *_of_coordinator("only workers whose name begins with this"),
        _switch("--coordinator", "show the coordinator's own counters"),
    )),
    "result": ("print the equations of a job; while it runs, the best so far", (
        *_of_coordinator("id or its beginning, or PATH/result.json", nargs=None),
        _value("--format", None, "form of the output (default: text)", choices=_RESULT_FORMATS),
        _PICK,
    )),
    "cancel": (
        "end a job and keep its best equations",
        _of_coordinator("id or its beginning (default: the only one not ended)"),
    ),
    "delete": (
        "delete a job that has ended, with its result and its data",
        _of_coordinator("id or its beginning", nargs=None),
    ),
    "pause": (
        "have a job stop at a checkpoint and wait; it keeps its place",
        _of_coordinator("id or its beginning", nargs=None),
    ),
    "resume": ("let a paused job go on", _of_coordinator("id or its beginning", nargs=None)),
    "priority": ("give a job another priority", (
        *_of_coordinator("id or its beginning", nargs=None),
        _value("priority", "N", "-10 to 10", type=whole_number(-10, 10)),
    )),
    "share": ("let everybody see a job", (
        *_of_coordinator("id or its beginning", nargs=None),
        _switch("--private", "let only its submitter and admins see it"),
    )),
    "retry": ("submit a job that failed or was cancelled once more; prints the new job's id", (
        *_of_coordinator("id or its beginning", nargs=None),
        _value("--id", "ID", "the new job's id (default: made up)"),
    )),
    "logs": ("tell what happened to a job", (
        *_of_coordinator("id or its beginning (default: what happened at all)"),
        _switch("--follow", "go on until the job has ended"),
        _switch("--workers", "only what workers have logged"),
        _value(
            "--level", "LEVEL", "only what is of this level or above: info, warning, error (default: %(default)s)",
            choices=("info", "warning", "error"), default="info",
        ),
        _value("--lines", "N", "at most the N last events (default: 200)", type=whole_number(1, 1000), default=200),
    )),
    "cordon": ("give a worker no more islands (admins)", _of_coordinator("name or its beginning", nargs=None)),
    "uncordon": ("let a worker have islands again (admins)", _of_coordinator("name or its beginning", nargs=None)),
    "drain": (
        "have a worker hand over its islands, and give it no more (admins)",
        _of_coordinator("name or its beginning", nargs=None),
    ),
    "queue": ("show how many jobs wait; take up no more of them, or go on (admins)", (
        _value("change", None, "pause or resume (default: only show)", nargs="?", choices=("pause", "resume")),
        *_CONNECT,
        _JSON,
    )),
    "simulate": ("simulate the model of a result from any initial state; CSV with bands", (
        _RESULT,
        *_CONNECT,
        _value(
            "--initial", "x=1,y=3|FILE",
            "initial state; or a data file: its first row, its times, its inputs (default: as measured)",
        ),
        _GROUP,
        _UNTIL,
        _value("--step", "DT", "from one time to the next (default: 500 steps in all)"),
        _repeatable("--hold", "u=1", "value of an input (default: as measured)"),
        _value(
            "--paths", "N",
            "of a stochastic process: draw so many paths; mean, median and the bounds that 5 %% lie beyond",
        ),
        _value("--seed", "S", "of the paths (default: 0)"),
        _switch("--each-path", "write each path, as rows with a column trajectory, instead of bounds"),
        _OUTPUT,
        _switch("--json", "write JSON: status, message, columns"),
    )),
    "analyse": ("fixed points, limit cycles, basins and bifurcations of the model of a result", (
        _RESULT,
        *_CONNECT,
        _repeatable("--box", "x=0:3", "bounds of a state (default: half the measured range more on either side)"),
        _GROUP,
        _HOLD,
        _switch("--identifiability", "what the data determine of each constant, by profile likelihood"),
        _DATA,
        _value(
            "--parameter", "c1",
            "what varies: a constant, several in their ratio (c1,c2), a coefficient (y:x*y of x*y in dy/dt), an input",
        ),
        _value("--range", "A:B", "what --parameter is varied over"),
        _OUTPUT,
        _switch("--json", "write JSON, with all curves"),
    )),
    "report": ("a result as one HTML page that needs neither network nor script", (
        _value("result", "RESULT", "PATH/result.json, its folder, or the id of a job; several, if you like", nargs="+"),
        *_CONNECT,
        _GROUP,
        _output("the page (default: report.html beside the result)"),
        _value("--pictures", "DIR", "also write every picture as an SVG file of its own"),
    )),
    "suggest": ("the next experiment: where the candidates of a result differ most", (
        _RESULT,
        *_CONNECT,
        _GROUP,
        _repeatable(
            "--box", "x=0:3", "bounds of an initial state or a constant input (default: the range of the data)"
        ),
        _value("--duration", "T", "of an experiment (default: of the median trajectory)"),
        _value("--samples", "N", "measurements of each state (default: of the median trajectory)"),
        _value(
            "--cost", "trajectory|duration|samples", default="trajectory",
            text="what an experiment costs: as much as any other, its duration, its samples (default: trajectory)",
        ),
        _value("--count", "N", "how many experiments (default: 3)", default="3"),
        _repeatable(
            "--rival", "dx=EXPR",
            "another system to tell apart, its equations separated by ';', its constants fitted",
        ),
        _value("--seed", "S", "of the experiments that are tried (default: 0)", default="0"),
        _DATA,
        _OUTPUT,
        _switch("--json", "write JSON, with all times"),
    )),
    "compare": ("two results, or two candidates of one: which describes the data better, and how sure that is", (
        _value("first", "A", "PATH/result.json, its folder or the id of a job; with :N candidate N of it, 1 the best"),
        _value("second", "B", "the other one, or :N for a candidate of the same result"),
        *_CONNECT,
        _GROUP,
        _DATA,
        _OUTPUT,
        _switch("--json", "write JSON"),
    )),
    "export": ("write the model of a result for other programs", (
        _RESULT,
        *_CONNECT,
        _GROUP,
        _value("--format", None, "what to write; see docs/export.md", required=True, choices=EXPORT_FORMATS),
        _output("write to this file (default: stdout); of petab the folder"),
        _PICK,
        _value(
            "--candidate", "N", "take candidate N of the comparison, 1 the best", type=whole_number(1, 1000)
        ),
        _value(
            "--initial", "x=1,y=3|FILE", "initial state, times and inputs, as for simulate (default: as measured)"
        ),
        _UNTIL,
        _value("--step", "DT", "from one time to the next"),
        _HOLD,
        _DATA,
    )),
    "doctor": ("examine this machine, a coordinator and data files, and say what to do; 1: problems", (
        _value("data", "DATA", "data files to read as `submit` would", nargs="*"),
        _value("--connect", "tcp/HOST:PORT", "the coordinator to examine (default: $ATOLL_CONNECT, if set)"),
        _value("--listen", "tcp/HOST:PORT", "an address at which a coordinator shall listen: is it free?"),
        _value("--state", "DIR", "the folder of a coordinator's job store (default: the current)"),
        _switch("--quick", "look only whether the coordinator's address accepts connections"),
        _JSON,
        add_tls_options,
        _job_options("data"),
    )),
    "schema": (
        "print what a --config file or a result file may hold, as JSON schema",
        (_value("file", None, "default: config", nargs="?", choices=("config", "result"), default="config"),),
    ),
    "completion": (
        "print what makes a shell complete commands and options",
        (_value("shell", None, "where the printed lines are to be read", choices=SHELLS),),
    ),
}  # fmt: skip
"""Each verb with a line on it and what adds its arguments, in the order of the help."""
