"""Templates of files. Pure.

`$name` is a value, of a list how many items it has. `<<items|text|separator>>` is the text for each item, the separator
", " unless given. Lines of their own say what becomes of others: ``$for items:line`` repeats a line for each item, with
a comma between two as ``$for items,:line`` (or a semicolon); ``$if name:line`` keeps it where a value is neither 0 nor
empty, ``$unless name:line`` where it is. With nothing behind the colon they hold for all lines down to their ``$end``.
Within an item its values hide those around it.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final

Value = str | float | Sequence[Mapping[str, "Value"]]
Values = Mapping[str, Value]

_LINE: Final = re.compile(r"\$(for|if|unless) (\w+)([,;]?):(.*)")
_PART: Final = re.compile(r"<<(\w+)\|(.*?)(?:\|(.*?))?>>|\$(\w+)")


def fill(template: str, values: Values) -> list[str]:
    """Return the lines of a template with values; raises KeyError where one is not there."""
    return list(_filled(template.splitlines(), values))


def _filled(template: Iterable[str], values: Values) -> Iterator[str]:
    lines = iter(template)
    for line in lines:
        instruction = _LINE.fullmatch(line)
        if instruction is None:
            yield _text(line, values)
            continue
        word, name, separator, rest = instruction.groups()
        body = [rest] if rest else [*_block(lines)]
        if word == "for":
            yield from _repeated(body, _scopes(name, values), separator)
        elif bool(values[name]) is (word == "if"):
            yield from _filled(body, values)


def _block(lines: Iterator[str]) -> Iterator[str]:
    """Yield the lines before the ``$end`` of a block that has begun, and take that one too."""
    depth = 1
    for line in lines:
        instruction = _LINE.fullmatch(line)
        depth += -1 if line == "$end" else instruction is not None and not instruction[4]
        if not depth:
            return
        yield line


def _repeated(body: Sequence[str], scopes: Sequence[Values], separator: str) -> Iterator[str]:
    for number, scope in enumerate(scopes, start=1):
        *lines, last = _filled(body, scope)
        yield from lines
        yield last + (separator if number < len(scopes) else "")


def _scopes(name: str, values: Values) -> list[Values]:
    """Return the values that each item of a list sees."""
    items = values[name]
    assert not isinstance(items, str | float | int), f"{name} is no list"
    return [{**values, **item} for item in items]


def _text(line: str, values: Values) -> str:
    def written(part: re.Match[str]) -> str:
        items, text, separator, name = part.groups()
        if name:
            value = values[name]
            return str(value if isinstance(value, str | float | int) else len(value))
        return (", " if separator is None else separator).join(_text(text, scope) for scope in _scopes(items, values))

    return _PART.sub(written, line)
