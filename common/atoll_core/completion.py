"""Completion of the words of a command line, when a shell asks for it. Light, because every command begins here."""

import argparse
import os
import re
from collections.abc import Callable, Iterator
from typing import Any

SHELLS = ("bash", "zsh", "fish")
_ALTERNATIVES = re.compile(r"[a-z0-9]+(?:\|[a-z0-9]+)+")


def complete(parser: argparse.ArgumentParser, **settings: Any) -> None:
    """Answer a shell that asks how its words go on, and end the process; else do nothing.

    `settings` are those of `argcomplete.autocomplete`.
    """
    if "_ARGCOMPLETE" not in os.environ:
        return
    import argcomplete

    for verb_parser in _parsers(parser):
        for action in verb_parser._actions:
            if isinstance(action.metavar, str) and _ALTERNATIVES.fullmatch(action.metavar):
                action.completer = _chooser(action.metavar.split("|"))  # type: ignore[attr-defined]
    argcomplete.autocomplete(parser, **settings)


def _chooser(words: list[str]) -> Callable[..., list[str]]:
    return lambda **_: words


def _parsers(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """Yield a parser and those of its verbs."""
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            yield from action.choices.values()
