"""The tree of all errors. Every message is one sentence: what was found, what was expected, what to do."""

import errno
from typing import Final, NamedTuple

from atoll_core.redaction import without_secrets

_PASSING: Final = frozenset({
    errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EAGAIN, errno.EBUSY,
    errno.ESTALE, errno.ETIMEDOUT, errno.EADDRINUSE, errno.EADDRNOTAVAIL, errno.ENETDOWN,
    errno.EROFS,
})  # fmt: skip


def may_pass(error: OSError) -> bool:
    """Tell whether an operation may succeed later with the same options, as when a full disk has room again."""
    return error.errno in _PASSING


class Field(NamedTuple):
    """An option, with or without a value: `order=2` in Python is ``--order 2`` on the command line."""

    name: str
    value: object = None

    @property
    def in_python(self) -> str:
        """The keyword."""
        return self.name if self.value is None else f"{self.name}={self.value!r}"

    @property
    def on_command_line(self) -> str:
        """The option."""
        option = f"--{self.name.replace('_', '-')}"
        return option if self.value is None else f"{option} {self.value}"


class AtollError(Exception):
    """Root of all errors that are meant for users; `exit_code` is the exit code of the program.

    Options and advice differ between Python and the command line: the text of the error is for Python, and
    `on_command_line` is its text for the command line. `fields` are the names of the options in the sentence.
    """

    exit_code = 1

    def __init__(self, sentence: str = "", *parts: object, python: str = "", command: str = "") -> None:
        """Take the whole sentence, or its beginning with different ends: `python` and `command` (for the command line).

        `parts` replace ``%s`` in `sentence`; a `Field` is written as a keyword in Python and as an option on the
        command line.
        """
        self.fields = tuple(part.name for part in parts if isinstance(part, Field))
        in_python = on_command_line = sentence
        if parts:
            in_python %= tuple(part.in_python if isinstance(part, Field) else part for part in parts)
            on_command_line %= tuple(part.on_command_line if isinstance(part, Field) else part for part in parts)
        super().__init__(without_secrets(f"{in_python}; {python}" if python else in_python))
        self.on_command_line = without_secrets(f"{on_command_line}; {command}" if command else on_command_line)


class UsageError(AtollError):
    """Raised when options are unknown, contradictory or out of range."""

    exit_code = 2


class NotNowError(UsageError):
    """Raised when something is not available now, but may be later: a port in use, a full disk. Try again."""

    exit_code = 1


class DataError(AtollError):
    """Raised when measurements cannot be read or cannot be used as they are."""

    exit_code = 2


class UnreachableError(AtollError):
    """Raised when no coordinator answers at the given address."""

    exit_code = 3


class RefusedError(AtollError):
    """Raised when the other side answers with a refusal, such as a version mismatch or an unknown job."""

    exit_code = 2


class UnknownJobError(RefusedError):
    """Raised when there is no such job, or when this user may not see it."""


class TableMissingError(RefusedError):
    """Raised when the coordinator does not (or no longer) have the table of a submitted job: upload it again."""


class LocalProtocolError(AtollError):
    """Raised when this program violates the protocol: a bug; the process stops."""


class RemoteProtocolError(AtollError):
    """Raised when a peer's message is malformed, oversized or foreign: counted, logged once, dropped."""


class StoreError(AtollError):
    """Raised when the coordinator's store cannot be opened, read or written, perhaps for a short time (full disk)."""


class WrongStoreError(StoreError):
    """Raised when a path is no store, no store of this version, or exists already: name another path."""

    exit_code = 2
