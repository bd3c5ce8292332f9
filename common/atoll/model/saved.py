"""Results as they are saved: the content of ``result.json``."""

import json
from pathlib import Path
from typing import Any, Final

from atoll.errors import UsageError
from atoll.model.arguments import path_of

SCHEMA: Final = 1


def check_result(found: object) -> dict[str, Any]:
    """Return the content of a result.json; raises UsageError when it is none, or of another version."""
    equations = found.get("equations") if isinstance(found, dict) and found.get("schema") == SCHEMA else None
    known = ("variable", "lhs", "expression")
    if (
        not isinstance(found, dict)
        or not isinstance(equations, list)
        or not isinstance(found.get("symbols"), dict)
        or not all(isinstance(each, dict) and set(known) <= set(each) for each in equations)
    ):
        raise UsageError("this is no result of this version; give the content of a saved result.json")
    return found


def read_result(path: str | Path) -> dict[str, Any]:
    """Return a saved result; raises UsageError when the file cannot be read or holds none."""
    try:
        found = json.loads(path_of(path).read_text("utf-8"))
    except OSError as error:
        raise UsageError(f"{path} cannot be read ({error.strerror}); give the path of a saved result.json") from error
    except ValueError as error:
        raise UsageError(f"{path} holds no JSON; give the path of a saved result.json") from error
    try:
        return check_result(found)
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None


def write_text(path: str | Path, text: str) -> None:
    """Write a file; raises UsageError."""
    try:
        path_of(path).write_text(text, "utf-8")
    except OSError as error:
        raise UsageError(f"{path} cannot be written ({error.strerror}); name another file") from error
