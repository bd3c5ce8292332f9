"""Which installation a program was loaded from: a task process and its worker must have the same one."""

from typing import Final

from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION

OTHER_VERSION: Final = 71
"""Exit code of a task process that was loaded from another version than its worker: the program was replaced."""


def version() -> str:
    """Return in one word what of an installation decides which bits come of a task."""
    return f"{VERSION}/{PROTOCOL_VERSION}/{ENGINE_REVISION}"
