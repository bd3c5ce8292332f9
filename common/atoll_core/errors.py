"""The one tree of errors. Every message is one sentence: what was found, what was expected, what to do."""

import errno
from typing import Final, NamedTuple

from atoll_core.redaction import without_secrets

_PASSING: Final = frozenset({
    errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EAGAIN, errno.EBUSY,
    errno.ESTALE, errno.ETIMEDOUT, errno.EADDRINUSE, errno.EADDRNOTAVAIL, errno.ENETDOWN,
    errno.EROFS,
})  # fmt: skip


def may_pass(error: OSError) -> bool:
    """Tell whether what the system refused may be had later, with the same options: a full disk."""
    return error.errno in _PASSING


class Field(NamedTuple):
    """What a person sets, perhaps to a value: `order=2` in Python is ``--order 2`` on the command line."""

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
    """Root of all errors that are meant for a person; `exit_code` is what a program ends with.

    What to set and what to do have other names in Python than on the command line: the text of the error is for
    Python, `on_command_line` for programs, and `fields` are the names of what the sentence says is to be set.
    """

    exit_code = 1

    def __init__(self, sentence: str = "", *parts: object, python: str = "", command: str = "") -> None:
        """Take the sentence, or its beginning and how it goes on in Python and on the command line.

        `parts` take the places of ``%s`` in it, each `Field` among them in the words of either side.
        """
        self.fields = tuple(part.name for part in parts if isinstance(part, Field))
        said = _filled(sentence, [part.in_python if isinstance(part, Field) else part for part in parts])
        typed = _filled(sentence, [part.on_command_line if isinstance(part, Field) else part for part in parts])
        super().__init__(without_secrets(f"{said}; {python}" if python else said))
        self.on_command_line = without_secrets(f"{typed}; {command}" if command else typed)


def _filled(sentence: str, parts: list[object]) -> str:
    return sentence % tuple(parts) if parts else sentence


class UsageError(AtollError):
    """Raised when options are unknown, contradictory or out of range."""

    exit_code = 2


class NotNowError(UsageError):
    """Raised when what was asked for cannot be had now, which may pass: a port in use, a full disk. Try again."""

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
    """Raised when there is no such job, or none that we may see."""


class TableMissingError(RefusedError):
    """Raised when a job is submitted whose table the coordinator does not have, or not any more: upload it again."""


class LocalProtocolError(AtollError):
    """Raised when our own side breaks the protocol: a bug; the process stops."""


class RemoteProtocolError(AtollError):
    """Raised when a peer's message is malformed, oversized or foreign: counted, logged once, dropped."""


class StoreError(AtollError):
    """Raised when the coordinator's store cannot be opened, read or written, which may pass: a disk that is full."""


class WrongStoreError(StoreError):
    """Raised when what was named is no store, or none of this version, or is there already: name something else."""

    exit_code = 2
