"""Reads files of results. Users may have truncated or edited them, so the first error is reported in one sentence."""

import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final, Literal, TypeVar

from pydantic import BaseModel, JsonValue, ValidationError
from pydantic_core import ErrorDetails

from atoll_coordinator.result.upgrade import upgraded
from atoll_core.errors import UsageError
from atoll_core.quoting import path_of, shown, similar_file

SCHEMA: Final[Literal[1]] = 1
RESULT: Final = "result.json"

_UNWRITABLE: Final = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")
"""Control characters, and characters that XML or UTF-8 cannot represent."""

_KINDS: Final = {
    "string_type": "text",
    "bool_type": "true or false",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "positive": "a number above 0",
    "tuple_type": "a list",
    "too_short": "a list of at least one item",
    "too_long": "two numbers",
    "dict_type": "an object",
    "model_type": "an object",
    "model_attributes_type": "an object",
}
"""The expected value, by pydantic's name of the error."""

_Whole = TypeVar("_Whole", bound=BaseModel)


def read_file(path: str | Path) -> tuple[Path, object]:
    """Return the path of a result (given by its file or folder) and its JSON content; raises UsageError."""
    file_or_folder = path_of(path)
    file = file_or_folder / RESULT if file_or_folder.is_dir() else file_or_folder
    try:
        return file, json.loads(file.read_text("utf-8"))
    except OSError as error:
        hint = similar_file(file_or_folder)
        raise UsageError(
            f"{file} cannot be read ({error.strerror}); give the path of a saved result.json{hint}"
        ) from error
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{file} is not valid JSON; give the path of a saved result.json") from error


def as_parts(whole: type[_Whole], content: object) -> _Whole:
    """Return the content of a result.json as the model `whole`; raises UsageError if it is not a result.

    Characters that pages or terminals cannot show are escaped in texts, as ``\\x01``.
    """
    written = _escape_characters(content)
    if not isinstance(written, Mapping) or not _is_result(written):
        raise UsageError("this is no result of this version; give the content of a saved result.json")
    try:
        return whole.model_validate(upgraded(written))
    except ValidationError as error:
        raise UsageError(_describe_error(error.errors(include_url=False)[0])) from None


def _is_result(content: Mapping[str, object]) -> bool:
    equations = content.get("equations")
    return (
        content.get("schema") == SCHEMA
        and isinstance(content.get("symbols"), Mapping)
        and isinstance(equations, list | tuple)
        and all(
            isinstance(equation, Mapping) and {"variable", "lhs", "expression"} <= {*equation} for equation in equations
        )
    )


_PLAIN: Final = frozenset({float, int, bool, type(None)})
"""Types of values without texts; curves have thousands of them."""


def _escape_characters(value: object) -> object:
    """Return a value with the characters `_UNWRITABLE` escaped in all texts and names; values without texts are
    unchanged."""
    if isinstance(value, str):
        return _UNWRITABLE.sub(lambda match: match[0].encode("unicode_escape").decode(), value)
    if isinstance(value, Mapping):
        return {_escape_characters(name): _escape_characters(part) for name, part in value.items()}
    if isinstance(value, list | tuple) and not _PLAIN.issuperset(map(type, value)):
        return [_escape_characters(part) for part in value]
    return value


def _describe_error(fault: ErrorDetails) -> str:
    """Return the first error of the content as a sentence."""
    kind, key = fault["type"], next((name for name in reversed(fault["loc"]) if isinstance(name, str)), "the result")
    if kind == "inconsistent":
        return fault["msg"]
    if kind == "missing":
        return f"this result lacks {key!r}; give the unchanged result.json"
    expected = _KINDS.get(kind)
    if kind == "literal_error":
        expected = " or ".join(sorted(fault.get("ctx", {})["expected"].replace("'", "").split(" or ")))
    return f"this result has {shown(fault['input'])} as {key!r}, where {expected or 'another value'} is expected; " + (
        "give the unchanged file"
    )


def json_of(content: JsonValue) -> str:
    """Return plain values as JSON on one line; numbers that are not finite are null."""
    try:
        return json.dumps(content, ensure_ascii=False, allow_nan=False)
    except ValueError:
        return json.dumps(_finite(content), ensure_ascii=False, allow_nan=False)


def _finite(value: JsonValue) -> JsonValue:
    if isinstance(value, dict):
        return {name: _finite(part) for name, part in value.items()}
    if isinstance(value, list):
        return [_finite(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
