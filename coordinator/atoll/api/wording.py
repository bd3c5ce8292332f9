"""What the service and the readers of data say of options of the command line, in the words of Python.

Errors of the options themselves name fields, see `atoll_core.errors`.
"""

import contextlib
import re
from collections.abc import Iterator
from typing import Final

from atoll_core.errors import AtollError, Field

_TLS: Final = re.compile(r"--tls-(ca|cert|key)(?: \(ATOLL_TLS_\w+\))?")
_WITH_NUMBER: Final = re.compile(r"--([a-z][a-z-]*)[ =](\d+)\b")
_COLUMN_OPTIONS: Final = "angle|group|hold|inputs|missing|states|target|time|trajectory|weights"
_WITH_COLUMN: Final = re.compile(rf"--({_COLUMN_OPTIONS}) (COLUMN\b|\w+(?:,\w+)*(?=[;,.)]|$| keeps))")
_QUOTED: Final = re.compile(rf"--({_COLUMN_OPTIONS}) '([^']+)'")
_OPTION: Final = re.compile(r"--([a-z][a-z-]*)")


def in_python(sentence: str) -> str:
    """Return a sentence with keyword arguments in the place of options: ``--max-size`` is max_size."""
    sentence = sentence.replace("--tls-...", "tls").replace("--missing drop", "missing='drop'")
    sentence = _TLS.sub(r"tls['\1']", sentence)
    sentence = _WITH_NUMBER.sub(lambda match: Field(match[1].replace("-", "_"), int(match[2])).in_python, sentence)
    for pattern in (_QUOTED, _WITH_COLUMN):
        sentence = pattern.sub(lambda match: Field(match[1], match[2]).in_python, sentence)
    return _OPTION.sub(lambda match: match[1].replace("-", "_"), sentence)


@contextlib.contextmanager
def python_words() -> Iterator[None]:
    """Raise the errors of a block in the words of Python."""
    try:
        yield
    except AtollError as error:
        sentence = in_python(str(error))
        if sentence == str(error):
            raise
        reworded = type(error)(sentence)
        reworded.on_command_line = error.on_command_line
        raise reworded from error
