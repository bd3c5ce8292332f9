"""The one tree of errors. Every message is one sentence: what was found, what was expected, what to do."""


class AtollError(Exception):
    """Root of all errors that are meant for a person; `exit_code` is what a program ends with.

    What to do may have another name in Python than on the command line: the text of the error is for Python,
    `on_command_line` for programs.
    """

    exit_code = 1

    def __init__(self, sentence: str = "", *, python: str = "", command: str = "") -> None:
        """Take the sentence, or its beginning and how it goes on in Python and on the command line."""
        super().__init__(f"{sentence}; {python}" if python else sentence)
        self.on_command_line = f"{sentence}; {command}" if command else sentence


class UsageError(AtollError):
    """Raised when options are unknown, contradictory or out of range."""

    exit_code = 2


class DataError(AtollError):
    """Raised when measurements cannot be read or cannot be used as they are."""

    exit_code = 2


class UnreachableError(AtollError):
    """Raised when no coordinator answers at the given address."""

    exit_code = 3


class RefusedError(AtollError):
    """Raised when the other side answers with a refusal, such as a version mismatch or an unknown job."""

    exit_code = 2


class TableMissingError(RefusedError):
    """Raised when a job is submitted whose table the coordinator does not have, or not any more: upload it again."""


class LocalProtocolError(AtollError):
    """Raised when our own side breaks the protocol: a bug; the process stops."""


class RemoteProtocolError(AtollError):
    """Raised when a peer's message is malformed, oversized or foreign: counted, logged once, dropped."""


class StoreError(AtollError):
    """Raised when the coordinator's store cannot be opened, read or written."""
