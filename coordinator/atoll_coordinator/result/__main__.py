"""``python -m atoll_coordinator.result`` writes ``result.schema.json`` and the reference docs/result-keys.md.

Both are generated from the classes of the parts. Run this command in a checkout after each change of a part.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from atoll_coordinator.result.result import json_schema, schema_text

REFERENCE: Final = "docs/result-keys.md"
_HEAD: Final = """# Keys of result.json

Made by `python -m atoll_coordinator.result`; [result.md](result.md) explains the ideas. Unknown and non-finite values
are null. Values marked `[]` are lists; values marked `{}` have an entry for each name.
"""
_KINDS: Final = {"string": "text", "number": "number", "integer": "whole number", "boolean": "true or false"}


def reference() -> str:
    """Return a page with a table for each part of a result: first the whole result, then its parts in the order of
    their keys."""
    whole: dict[str, Any] = json_schema()
    parts = whole.pop("$defs")
    text, waiting, done = _HEAD, [("Result", whole)], {"Result", "JsonValue"}
    while waiting:
        name, part = waiting.pop(0)
        text += f"\n## {name}\n\n{part['description'].splitlines()[0]}\n\n| key | value | meaning |\n|---|---|---|\n"
        for key, field in part["properties"].items():
            kind, others = _kind(field)
            text += f"| `{key}` | {kind} | {field.get('description', '')} |\n"
            new = [other for other in others if other not in done]
            done.update(new)
            waiting += [(other, parts[other]) for other in new]
    return text


def _kind(field: dict[str, Any]) -> tuple[str, list[str]]:
    """Return the type of a field, and the parts to which it refers."""
    names = [str(reference).rsplit("/", 1)[-1] for reference in _references(field) if reference != "#/$defs/JsonValue"]
    marks = f"{'[]' * str(field).count('array')}{'{}' * ('additionalProperties' in str(field))}"
    if names:
        return ", ".join(f"[{name}](#{name.lower()}){marks}" for name in names), names
    options = field.get("anyOf", [field])
    kinds = [_KINDS[kind] for kind in _KINDS if f"'{kind}'" in str(options)]
    return (f"{kinds[0]}{marks}" if len(kinds) == 1 else marks or "any"), []


def _references(field: object) -> Iterator[object]:
    """Yield the parts that a schema refers to."""
    for key, value in field.items() if isinstance(field, dict) else ():
        if key == "$ref":
            yield value
        yield from _references(value)
    for value in field if isinstance(field, list) else ():
        yield from _references(value)


if __name__ == "__main__":
    Path(__file__).with_name("result.schema.json").write_text(schema_text(), "utf-8")
    Path(REFERENCE).write_text(reference(), "utf-8")
