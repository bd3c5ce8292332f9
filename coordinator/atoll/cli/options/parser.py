"""The command line itself: verbs, options, help. Standard library only, because ``--help`` must be instant.

The options of a job are generated from their table, `atoll.client.options`; what a verb does is in the module that
`HANDLERS` names.
"""

import argparse
from collections.abc import Sequence
from typing import Final, NoReturn

from atoll.cli.options.service import Verbs, add_doctor, add_router, add_serve
from atoll.client.options import GROUPS, MOST_WORKERS
from atoll_core.command_line import Parser, add_tls_options, seconds, whole_number
from atoll_core.completion import SHELLS, complete
from atoll_core.errors import UsageError

HANDLERS: Final = {
    "run": "atoll.cli.verbs.run",
    "serve": "atoll.cli.verbs.serve",
    "router": "atoll.cli.verbs.router",
    "submit": "atoll.cli.verbs.submit",
    "ping": "atoll.cli.verbs.ping",
    "jobs": "atoll.cli.verbs.jobs",
    "status": "atoll.cli.verbs.jobs",
    "workers": "atoll.cli.verbs.jobs",
    "cancel": "atoll.cli.verbs.jobs",
    "delete": "atoll.cli.verbs.jobs",
    "logs": "atoll.cli.verbs.logs",
    "result": "atoll.cli.verbs.result",
    "simulate": "atoll.cli.verbs.simulate",
    "analyse": "atoll.cli.verbs.analyse",
    "report": "atoll.cli.verbs.report",
    "suggest": "atoll.cli.verbs.suggest",
    "export": "atoll.cli.verbs.export",
    "doctor": "atoll.cli.doctor.doctor",
    "schema": "atoll.cli.verbs.schema",
    "completion": "atoll.cli.verbs.completion",
}
"""The module of each verb. Its function of the verb's name takes the parsed options and returns the exit code."""

EXIT_CODES: Final = (
    "exit codes: 0 done, 1 job failed, 2 bad usage or bad data, 3 coordinator not reachable,\n"
    "4 an explicit --target-error was not met within the budget, 130 detached or interrupted"
)
RESULT_FORMATS: Final = ("text", "json", "csv", "sympy", "latex")
EXPORT_FORMATS: Final = (
    "python", "c", "julia", "matlab", "modelica", "xppaut", "sbml", "latex", "sympy", "csv", "json", "petab"
)  # fmt: skip
MOST_LINES: Final = 1000


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """Return the parsed options; `verb` is one of `HANDLERS`.

    Raises:
        UsageError: an option or verb is unknown or incomplete.
        SystemExit: after ``--help`` or ``--version``.
    """
    parser = build_parser()
    complete(parser)
    options = parser.parse_args(_join_leading_minus(argv))
    if options.verb is None:
        raise UsageError(f"no command was given, expected one of {', '.join(HANDLERS)}; see coordinator --help")
    return options


def _join_leading_minus(argv: Sequence[str]) -> list[str]:
    """Write ``--operators -,+`` or ``--range -1:1`` as one word, since argparse takes a leading minus for an option."""
    words: list[str] = []
    for word in argv:
        is_list = words[-1:] == ["--operators"] and (word == "-" or word.startswith("-,"))
        is_number = words[-1:] == ["--range"] and word[:1] == "-" and word[1:2] in tuple("0123456789.")
        if is_list or is_number:
            words[-1] = f"{words[-1]}={word}"
        else:
            words.append(word)
    return words


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    parser = Parser(
        prog="coordinator",
        description="Atoll finds the differential equations behind measured trajectories.",
        epilog=EXIT_CODES,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version and exit")
    verbs = parser.add_subparsers(dest="verb", metavar="COMMAND", title="commands")
    _add_run(verbs)
    add_serve(_verb, verbs)
    add_router(_verb, verbs)
    _add_submit(verbs)
    _add_ping(verbs)
    _add_readers(verbs)
    _add_simulate(verbs)
    _add_analyse(verbs)
    _add_report(verbs)
    _add_suggest(verbs)
    _add_export(verbs)
    _add_options(add_doctor(_verb, verbs), "data")
    schema = _verb(verbs, "schema", "print what a --config file or a result file may hold, as JSON schema")
    schema.add_argument("file", nargs="?", choices=("config", "result"), default="config", help="default: config")
    completion = _verb(verbs, "completion", "print what makes a shell complete commands and options")
    completion.add_argument("shell", choices=SHELLS, help="where the printed lines are to be read")
    return parser


class _Version(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from atoll_core import PROTOCOL_VERSION, VERSION

        parser._print_message(f"coordinator {VERSION} (protocol {PROTOCOL_VERSION})\n")
        parser.exit()


def _verb(verbs: Verbs, name: str, text: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = verbs.add_parser(
        name,
        help=text,
        description=text[0].upper() + text[1:] + ".",
        epilog=EXIT_CODES,
    )
    return parser


def _add_run(verbs: Verbs) -> None:
    parser = _verb(verbs, "run", "search on this machine; nothing needs to be started beforehand")
    _add_job(parser)
    parser.add_argument(
        "--workers",
        type=whole_number(1, MOST_WORKERS),
        metavar="N",
        help="worker processes (default: one per core this process may use)",
    )
    parser.add_argument("--out", metavar="DIR", help="folder of result.json and the log (default: runs/JOB)")


def _add_submit(verbs: Verbs) -> None:
    parser = _verb(verbs, "submit", "give a job to a coordinator and follow it; Ctrl-C detaches, the job goes on")
    _add_connect(parser)
    _add_job(parser)
    parser.add_argument("--no-wait", action="store_true", help="print the job id, and nothing else, and return")
    parser.add_argument("--out", metavar="DIR", help="also write result.json into this folder")
    parser.add_argument(
        "--priority", type=whole_number(-10, 10), default=0, metavar="N",
        help="-10 to 10; each step doubles the job's share of the workers, and it is taken up sooner (default: 0)",
    )  # fmt: skip


def _add_ping(verbs: Verbs) -> None:
    parser = _verb(verbs, "ping", "ask whether a coordinator answers, as probes do; 3: it does not")
    _add_connect(parser)
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument(
        "--wait", type=seconds, default=5.0, metavar="SECONDS", help="how long to wait for it (default: %(default)g)"
    )


def _add_readers(verbs: Verbs) -> None:
    texts = {
        "jobs": ("list the jobs of a coordinator", "only jobs whose id begins with this"),
        "status": ("show how far a job has come", "id or its beginning (default: every job that has not ended)"),
        "workers": ("list the workers of a coordinator", "only workers whose name begins with this"),
        "result": (
            "print the equations of a job; while it runs, the best so far",
            "id or its beginning, or PATH/result.json",
        ),
        "cancel": ("end a job and keep its best equations", "id or its beginning (default: the only one not ended)"),
        "delete": ("delete a job that has ended, with its result and its data", "id or its beginning"),
        "logs": ("tell what happened to a job", "id or its beginning (default: what happened at all)"),
    }
    for name, (text, subject) in texts.items():
        parser = _verb(verbs, name, text)
        parser.add_argument("job", metavar="ID", nargs=None if name in ("result", "delete") else "?", help=subject)
        _add_connect(parser)
        parser.add_argument("--json", action="store_true", help="print JSON")
        if name == "jobs":
            parser.add_argument(
                "--last", type=whole_number(1, 10**9), metavar="N", help="only the N that came last (default: all)"
            )
        if name == "result":
            _add_result(parser)
        if name in ("status", "logs"):
            text = "go on until the job has ended" + (", with its exit code" if name == "status" else "")
            parser.add_argument("--follow", action="store_true", help=text)
        if name == "logs":
            parser.add_argument(
                "--lines",
                type=whole_number(1, MOST_LINES),
                default=200,
                metavar="N",
                help="at most the N last events (default: 200)",
            )
        if name == "workers":
            parser.add_argument("--coordinator", action="store_true", help="show the coordinator's own counters")


def _add_simulate(verbs: Verbs) -> None:
    parser = _verb(verbs, "simulate", "simulate the model of a saved result from any initial state; CSV with bands")
    parser.add_argument("result", metavar="RESULT", help="PATH/result.json, or its folder")
    parser.add_argument(
        "--initial",
        metavar="x=1,y=3|FILE",
        help="initial state; or a data file: its first row, its times, its inputs (default: as measured)",
    )
    _add_group(parser)
    parser.add_argument("--until", metavar="T", help="last time (default: that of the first trajectory, or the file's)")
    parser.add_argument("--step", metavar="DT", help="from one time to the next (default: 500 steps in all)")
    parser.add_argument(
        "--hold",
        action="append",
        default=[],
        metavar="u=1",
        help="value of an input (default: as measured); repeatable",
    )
    parser.add_argument(
        "--paths",
        metavar="N",
        help="of a stochastic process: draw so many paths; mean, median and the bounds that 5 %% lie beyond",
    )
    parser.add_argument("--seed", metavar="S", help="of the paths (default: 0)")
    parser.add_argument(
        "--each-path", action="store_true", help="write each path, as rows with a column trajectory, instead of bounds"
    )
    parser.add_argument("-o", "--output", metavar="FILE", help="write to this file (default: stdout)")
    parser.add_argument("--json", action="store_true", help="write JSON: status, message, columns")


def _add_group(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--group", metavar="NAME", help="the group of trajectories whose constants are taken, if any")


def _add_analyse(verbs: Verbs) -> None:
    parser = _verb(
        verbs, "analyse", "fixed points, limit cycles, basins and bifurcations of the model of a saved result"
    )
    parser.add_argument("result", metavar="RESULT", help="PATH/result.json, or its folder")
    parser.add_argument(
        "--box",
        action="append",
        default=[],
        metavar="x=0:3",
        help="bounds of a state (default: half the measured range more on either side); repeatable",
    )
    _add_group(parser)
    parser.add_argument(
        "--hold", action="append", default=[], metavar="u=1", help="value of an input (default: 0); repeatable"
    )
    parser.add_argument(
        "--identifiability", action="store_true", help="what the data determine of each constant, by profile likelihood"
    )
    _add_measurements(parser)
    parser.add_argument(
        "--parameter",
        metavar="c1",
        help="what varies: a constant, several in their ratio (c1,c2), a coefficient (y:x*y of x*y in dy/dt), an input",
    )
    parser.add_argument("--range", metavar="A:B", help="what --parameter is varied over")
    parser.add_argument("-o", "--output", metavar="FILE", help="write to this file (default: stdout)")
    parser.add_argument("--json", action="store_true", help="write JSON, with all curves")


def _add_report(verbs: Verbs) -> None:
    parser = _verb(verbs, "report", "a saved result as one HTML page that needs neither network nor script")
    parser.add_argument(
        "result", nargs="+", metavar="RESULT", help="PATH/result.json, or its folder; several, if you like"
    )
    _add_group(parser)
    parser.add_argument("-o", "--output", metavar="FILE", help="the page (default: report.html beside the result)")
    parser.add_argument("--pictures", metavar="DIR", help="also write every picture as an SVG file of its own")


def _add_suggest(verbs: Verbs) -> None:
    parser = _verb(verbs, "suggest", "the next experiment: where the candidates of a saved result differ most")
    parser.add_argument("result", metavar="RESULT", help="PATH/result.json, or its folder")
    _add_group(parser)
    parser.add_argument(
        "--box",
        action="append",
        default=[],
        metavar="x=0:3",
        help="bounds of an initial state or a constant input (default: the range of the data); repeatable",
    )
    parser.add_argument("--duration", metavar="T", help="of an experiment (default: of the median trajectory)")
    parser.add_argument("--samples", metavar="N", help="measurements of each state (default: of the median trajectory)")
    parser.add_argument(
        "--cost", metavar="trajectory|duration|samples", default="trajectory",
        help="what an experiment costs: as much as any other, its duration, its samples (default: trajectory)",
    )  # fmt: skip
    parser.add_argument("--count", metavar="N", default="3", help="how many experiments (default: 3)")
    parser.add_argument(
        "--rival", action="append", default=[], metavar="dx=EXPR",
        help="another system to tell apart, its equations separated by ';', its constants fitted; repeatable",
    )  # fmt: skip
    parser.add_argument("--seed", metavar="S", default="0", help="of the experiments that are tried (default: 0)")
    _add_measurements(parser)
    parser.add_argument("-o", "--output", metavar="FILE", help="write to this file (default: stdout)")
    parser.add_argument("--json", action="store_true", help="write JSON, with all times")


def _add_export(verbs: Verbs) -> None:
    parser = _verb(verbs, "export", "write the model of a saved result for other programs")
    parser.add_argument("result", metavar="RESULT", help="PATH/result.json, or its folder")
    _add_group(parser)
    parser.add_argument("--format", required=True, choices=EXPORT_FORMATS, help="what to write; see docs/export.md")
    parser.add_argument(
        "-o", "--output", metavar="FILE", help="write to this file (default: stdout); of petab the folder"
    )
    parser.add_argument(
        "--pick", action="append", default=[], metavar="x=2", help="take number 2 of the front of x; repeatable"
    )
    parser.add_argument(
        "--candidate",
        type=whole_number(1, MOST_LINES),
        metavar="N",
        help="take candidate N of the comparison, 1 the best",
    )
    parser.add_argument(
        "--initial",
        metavar="x=1,y=3|FILE",
        help="initial state, times and inputs, as for simulate (default: as measured)",
    )
    parser.add_argument("--until", metavar="T", help="last time (default: that of the first trajectory, or the file's)")
    parser.add_argument("--step", metavar="DT", help="from one time to the next")
    parser.add_argument(
        "--hold", action="append", default=[], metavar="u=1", help="value of an input (default: 0); repeatable"
    )
    _add_measurements(parser)


def _add_measurements(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--data", nargs="+", metavar="DATA", help="measurements to use in the place of those that the result has"
    )


def _add_result(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--format", choices=RESULT_FORMATS, help="form of the output (default: text)")
    parser.add_argument(
        "--pick", action="append", default=[], metavar="x=2", help="take number 2 of the front of x; repeatable"
    )


def _add_connect(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--connect", metavar="tcp/HOST:PORT", help="the coordinator (default: $ATOLL_CONNECT)")
    add_tls_options(parser)


def _add_job(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "data",
        nargs="+",
        metavar="DATA",
        help="data files: CSV and other text, Excel, MATLAB, HDF5, Parquet, NPZ, JSON",
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument("--report", action="store_true", help="also write the result as a page, report.html")
    parser.add_argument("--name", metavar="NAME", help="a label for lists (default: the first file's name)")
    parser.add_argument("--id", metavar="ID", help="the job's id (default: made up)")
    parser.add_argument("--config", metavar="job.toml", help="the same settings as a file; options override it")
    parser.add_argument(
        "--dry-run", action="store_true", help="say how the data are read and what would be searched; start nothing"
    )
    for group in GROUPS:
        _add_options(parser, group)


def _add_options(parser: argparse.ArgumentParser, group: str) -> None:
    """Add the options of a job that are in this group of their table."""
    arguments = parser.add_argument_group(group)
    for option in GROUPS[group]:
        if option.metavar is None:
            arguments.add_argument(option.flag, action="store_true", help=option.help)
        elif option.is_repeatable:
            text = f"{option.help}; repeatable"
            arguments.add_argument(option.flag, action="append", metavar=option.metavar, help=text)
        else:
            arguments.add_argument(option.flag, metavar=option.metavar, help=option.help)
