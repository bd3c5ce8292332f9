"""Keys and key expressions: which are legal, and which key an expression matches. The same on every bus.

A key is a path of non-empty chunks, such as ``atoll/r1/workers/w3/inbox``. In an expression a chunk may be ``*`` (any
one chunk) or ``**`` (any number of chunks, none included). A chunk that begins with ``@`` is only matched by itself.
"""

import itertools
from typing import Final

from atoll_core.errors import LocalProtocolError
from atoll_core.wire.bus.interface import MAX_PAYLOAD

_RESERVED: Final = frozenset("*$?#")


def check_key(key: str) -> str:
    """Return `key`; raises LocalProtocolError when it is not a legal concrete key."""
    if not all(_is_literal(chunk) for chunk in key.split("/")):
        raise LocalProtocolError(f"{key!r} is not a key: non-empty chunks without *, $, ?, # were expected")
    return key


def check_expression(expression: str) -> str:
    """Return `expression`; raises LocalProtocolError when it is not a legal key expression in canonical form."""
    chunks = expression.split("/")
    if not all(chunk in ("*", "**") or _is_literal(chunk) for chunk in chunks):
        raise LocalProtocolError(f"{expression!r} is not a key expression: chunks, * or ** were expected")
    if any(one == "**" and two in ("*", "**") for one, two in itertools.pairwise(chunks)):
        raise LocalProtocolError(f"{expression!r} is not canonical: write * before **, and ** once")
    return expression


def check_payload(key: str, payload: bytes) -> None:
    """Raise LocalProtocolError when `payload` is larger than what a bus carries."""
    if len(payload) > MAX_PAYLOAD:
        raise LocalProtocolError(f"{len(payload)} bytes for {key} are more than the {MAX_PAYLOAD} a bus carries")


def matches(expression: str, key: str) -> bool:
    """Return whether the key expression matches the concrete key. Pure; linear in expression times key."""
    reachable = {0}  # numbers of chunks of the key that the part of the expression read so far can have consumed
    chunks = key.split("/")
    for wanted in expression.split("/"):
        reachable = _after(wanted, reachable, chunks)
    return len(chunks) in reachable


def _after(wanted: str, reachable: set[int], chunks: list[str]) -> set[int]:
    if wanted != "**":
        return {place + 1 for place in reachable if place < len(chunks) and _fits(wanted, chunks[place])}
    result: set[int] = set()
    for place in reachable:
        result.add(place)
        while place < len(chunks) and _fits("*", chunks[place]):
            place += 1
            result.add(place)
    return result


def _fits(wanted: str, chunk: str) -> bool:
    return wanted == chunk or (wanted == "*" and not chunk.startswith("@"))


def _is_literal(chunk: str) -> bool:
    return bool(chunk) and _RESERVED.isdisjoint(chunk)
