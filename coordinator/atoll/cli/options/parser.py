"""The parser of the command line: what verbs there are is in `arguments`, what they do in the modules of `HANDLERS`."""

import argparse
from collections.abc import Sequence
from typing import Final, NoReturn

from atoll.cli.options.arguments import VERBS
from atoll_core.command_line import Parser, complete
from atoll_core.errors import UsageError

HANDLERS: Final = {
    "run": "atoll.cli.verbs.run",
    "serve": "atoll.cli.verbs.serve",
    "web": "atoll.cli.verbs.web",
    "backup": "atoll.cli.verbs.backup",
    "restore": "atoll.cli.verbs.backup",
    "router": "atoll.cli.verbs.router",
    "adapt": "atoll.cli.adapt.adapt",
    "submit": "atoll.cli.verbs.submit",
    "ping": "atoll.cli.verbs.ping",
    "jobs": "atoll.cli.verbs.jobs",
    "status": "atoll.cli.verbs.jobs",
    "workers": "atoll.cli.verbs.workers",
    "cancel": "atoll.cli.verbs.jobs",
    "delete": "atoll.cli.verbs.jobs",
    "pause": "atoll.cli.verbs.control",
    "resume": "atoll.cli.verbs.control",
    "priority": "atoll.cli.verbs.control",
    "share": "atoll.cli.verbs.control",
    "retry": "atoll.cli.verbs.control",
    "logs": "atoll.cli.verbs.logs",
    "cordon": "atoll.cli.verbs.control",
    "uncordon": "atoll.cli.verbs.control",
    "drain": "atoll.cli.verbs.control",
    "queue": "atoll.cli.verbs.control",
    "result": "atoll.cli.verbs.result",
    "simulate": "atoll.cli.verbs.models",
    "analyse": "atoll.cli.verbs.models",
    "report": "atoll.cli.verbs.report",
    "suggest": "atoll.cli.verbs.models",
    "compare": "atoll.cli.verbs.compare",
    "export": "atoll.cli.verbs.models",
    "doctor": "atoll.cli.doctor.doctor",
    "schema": "atoll.cli.verbs.schema",
    "completion": "atoll.cli.verbs.completion",
}
"""The module of each verb. Its function of the verb's name takes the parsed options and returns the exit code."""

EXIT_CODES: Final = (
    "exit codes: 0 done, 1 job failed or a reason that may pass (full disk, address in use), 2 bad usage or bad data,\n"
    "3 coordinator not reachable, 4 an explicit --target-error was not met within the budget,\n"
    "130 detached or interrupted"
)


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """Return the parsed options; `verb` is one of `HANDLERS`.

    Raises UsageError where an option or verb is unknown or incomplete, SystemExit after ``--help`` or ``--version``.
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
    commands = parser.add_subparsers(dest="verb", metavar="COMMAND", title="commands")
    for name, (text, arguments) in VERBS.items():
        verb = commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.", epilog=EXIT_CODES)
        for add in arguments:
            add(verb)
    return parser


class _Version(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from atoll_core import PROTOCOL_VERSION, VERSION

        parser._print_message(f"coordinator {VERSION} (protocol {PROTOCOL_VERSION})\n")
        parser.exit()
