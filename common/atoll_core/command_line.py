"""Parts of the command line that both programs share. Few imports, because ``--help`` must be fast."""

import argparse
import os
import re
import sys
from collections.abc import Callable, Sequence
from typing import Any, Final, NoReturn

from atoll_core.errors import AtollError, UsageError
from atoll_core.quoting import did_you_mean

LOG_FORMATS: Final = ("text", "json")
LOG_LEVELS: Final = ("debug", "info", "warning", "error")

TLS_OPTIONS: Final = {
    "--tls-ca": ("ATOLL_TLS_CA", "certificate of the authority that both sides trust"),
    "--tls-cert": ("ATOLL_TLS_CERT", "our certificate"),
    "--tls-key": ("ATOLL_TLS_KEY", "the certificate's private key, unencrypted"),
}
"""By option: the environment variable that replaces it, and the content of the file (all files are PEM)."""

_UNITS: Final = {"": 1.0, "ms": 1e-3, "s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0, "d": 86400.0}


class Parser(argparse.ArgumentParser):
    """Raises UsageError where argparse would print its usage and exit; abbreviated options are refused."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False, **settings)

    def parse_args(  # type: ignore[override]  # only this overload is used
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> argparse.Namespace:
        """Parse the words of a command line; raises UsageError, which suggests an option similar to an unknown one."""
        options, left = self.parse_known_args(args, namespace or argparse.Namespace())
        if left:
            used = self._verb_parser(options)
            hint = did_you_mean(left[0].partition("=")[0], used._option_string_actions) if left[0][:1] == "-" else ""
            kind = "unknown option" if left[0][:1] == "-" else "one word too many:"
            raise UsageError(f"{kind} {' '.join(left)}; see {used.prog} --help{hint}")
        return options

    def _print_message(self, message: str, file: Any = None) -> None:
        """Print help; raises AtollError if it cannot be written, except when the reader has closed the pipe."""
        stream = file or sys.stdout
        try:
            stream.write(message)
            stream.flush()
        except BrokenPipeError:
            pass
        except OSError as error:
            raise unwritable(error) from error

    def _verb_parser(self, options: argparse.Namespace) -> argparse.ArgumentParser:
        """Return the parser of the verb, or this parser if there is no verb."""
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):
                verb: argparse.ArgumentParser | None = action.choices.get(getattr(options, action.dest))
                return verb or self
        return self

    def error(self, message: str) -> NoReturn:
        text, hint = _reword(message)
        raise UsageError(f"{text}; see {self.prog} --help{hint}")


def unwritable(error: OSError) -> AtollError:
    """Return the error of an output that cannot be written."""
    return AtollError(f"the output cannot be written ({error.strerror}); make room, or send it elsewhere")


def _reword(message: str) -> tuple[str, str]:
    """Return argparse's message in our order (what was found, what was expected), and a suggestion or ""."""
    choice = re.fullmatch(r"argument (.+): invalid choice: (.+) \(choose from (.+)\)", message)
    if choice:
        known = [word.strip("' ") for word in choice[3].split(",")]
        hint = did_you_mean(choice[2].strip("'"), known)
        return f"{choice[1]} must be one of {choice[3]}, but {choice[2]} was given", hint
    switch = re.fullmatch(r"argument (.+): ignored explicit argument (.+)", message)
    if switch:
        return f"{switch[1]} takes no value, but {switch[2]} was given", ""
    missing = re.fullmatch(r"the following arguments are required: (.+)", message)
    if missing:
        return f"{missing[1]} is missing", ""
    return message.removeprefix("argument ").replace(": expected one argument", " needs a value"), ""


def whole_number(least: int, most: int) -> Callable[[str], int]:
    """Return the type of an option that is an integer within limits; it raises ArgumentTypeError."""

    def parse(text: str) -> int:
        if not (re.fullmatch("-?[0-9]{1,6}", text) and least <= int(text) <= most):
            raise argparse.ArgumentTypeError(f"expected a whole number from {least} to {most}, but {text!r} was given")
        return int(text)

    return parse


def duration(text: str) -> float:
    """Return the seconds of ``90``, ``90s``, ``30m`` or ``1.5h``, at least 0; raises ArgumentTypeError."""
    match = re.fullmatch(r"\s*([^\s]*?)(ms|min|[smhd]?)\s*", text)
    try:
        if match is not None:
            return seconds(match[1]) * _UNITS[match[2]]
    except argparse.ArgumentTypeError:
        pass
    raise argparse.ArgumentTypeError(f"a time such as 90s, 30m or 12h was expected, but {text!r} was given")


def seconds(text: str) -> float:
    """Return the number of seconds in `text`, at least 0; raises ArgumentTypeError."""
    try:
        number = float(text)
    except ValueError:
        number = -1.0
    if 0.0 <= number < 1e9:
        return number
    raise argparse.ArgumentTypeError(f"a number of seconds was expected, but {text!r} was given")


def add_log_options(parser: argparse.ArgumentParser) -> None:
    """Add ``--log-format`` and ``--log-level`` to a parser; see `atoll_core.logs.configure`."""
    parser.add_argument(
        "--log-format", choices=LOG_FORMATS, default="text", help="form of the log on stderr (default: text)"
    )
    parser.add_argument(
        "--log-level", choices=LOG_LEVELS, default="info", help="the least level that is logged (default: info)"
    )


def add_tls_options(parser: argparse.ArgumentParser) -> None:
    """Add ``--tls-ca``, ``--tls-cert`` and ``--tls-key``; see `atoll_core.wire.security.credentials`."""
    group = parser.add_argument_group(
        "certificates", "PEM files for tls/HOST:PORT; deploy/tls/make-authority makes them"
    )
    for option, (variable, text) in TLS_OPTIONS.items():
        group.add_argument(option, metavar="FILE", help=f"{text} (default: ${variable})")


SHELLS = ("bash", "zsh", "fish")
_ALTERNATIVES = re.compile(r"[a-z0-9]+(?:\|[a-z0-9]+)+")


def complete(parser: argparse.ArgumentParser, **settings: Any) -> None:
    """Answer a shell that asks for completions, and end the process; otherwise do nothing.

    `settings` are arguments of `argcomplete.autocomplete`.
    """
    if "_ARGCOMPLETE" not in os.environ:
        return
    import argcomplete

    verbs = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    for one in (parser, *(verb_parser for action in verbs for verb_parser in action.choices.values())):
        for action in one._actions:
            if isinstance(action.metavar, str) and _ALTERNATIVES.fullmatch(action.metavar):
                words = action.metavar.split("|")
                action.completer = lambda words=words, **_: words
    argcomplete.autocomplete(parser, **settings)
