"""Log lines: an event in a few words, then fields (job, variable, island, epoch, term, worker …), as text or as JSON.

Everybody logs through the standard library: ``_LOG.info("placed", extra=fields(job=job, term=3))``. Only the command
lines configure.
"""

import contextlib
import json
import logging
import sys
from collections.abc import Iterator, Mapping
from contextvars import ContextVar
from datetime import UTC, datetime
from types import MappingProxyType
from typing import Final

from atoll_core.redaction import redacted, without_secrets

_KEY: Final = "atoll_fields"
_SEEN: Final = "atoll_has_context"


_context: ContextVar[Mapping[str, object]] = ContextVar("what log lines are about", default=MappingProxyType({}))


@contextlib.contextmanager
def about(**values: object) -> Iterator[None]:
    """Let every line that is logged in this block have these fields, such as `job` or `task`; those that are None not.

    A line's own fields go before them, and inner blocks before outer ones. It holds for the thread, or the task of
    asyncio, that it was begun in.
    """
    given = {name: value for name, value in values.items() if value is not None}
    token = _context.set({**_context.get(), **given})
    try:
        yield
    finally:
        _context.reset(token)


def fields(**values: object) -> dict[str, object]:
    """Return what a log call takes as `extra`: the fields of the line; those that are None do not apply."""
    return {_KEY: {name: value for name, value in values.items() if value is not None}}


class TextLines(logging.Formatter):
    """``2026-01-01T00:00:00.000Z INFO placed job=a term=3 (atoll_coordinator.service.job_controller)``, on one line."""

    def __init__(self, context: dict[str, object]) -> None:
        """`context` stands in every line."""
        super().__init__()
        self._context = context

    def format(self, record: logging.LogRecord) -> str:
        """Return the line, with a traceback below it if there is one."""
        said = " ".join(f"{name}={_quoted(value)}" for name, value in (self._context | fields_of(record)).items())
        line = " ".join(part for part in (_time(record), record.levelname, record.getMessage(), said) if part)
        text = f"{line} ({record.name})"
        trace = trace_of(record)
        return without_secrets(f"{text}\n{trace}" if trace else text)


class JsonLines(logging.Formatter):
    """One JSON object for each line: time, level, logger, event, then the fields."""

    def __init__(self, context: dict[str, object]) -> None:
        """`context` stands in every line."""
        super().__init__()
        self._context = context

    def format(self, record: logging.LogRecord) -> str:
        """Return the line; a traceback is the field `exception`."""
        said: dict[str, object] = {
            "time": _time(record), "level": record.levelname.lower(), "logger": record.name,
            "event": record.getMessage(),
        }  # fmt: skip
        if trace := trace_of(record):
            said["exception"] = trace
        return json.dumps(redacted(self._context | fields_of(record) | said), ensure_ascii=False)


def configure(
    form: str = "text", level: str = "info", handler: logging.Handler | None = None, **context: object
) -> None:
    """Send the log to `handler`, or to stderr, one line an event from `level` on; `context` stands in every line."""
    handler = handler or logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonLines(context) if form == "json" else TextLines(context))
    handler.addFilter(with_context)
    logging.basicConfig(level=level.upper(), handlers=[handler], force=True)


def with_context(record: logging.LogRecord) -> bool:
    """Give a line, once, the fields of what it is about: by then it may be written by another thread."""
    if not getattr(record, _SEEN, False):
        setattr(record, _KEY, {**_context.get(), **getattr(record, _KEY, {})})
        setattr(record, _SEEN, True)
    return True


def fields_of(record: logging.LogRecord) -> dict[str, object]:
    """Return the fields of a line."""
    with_context(record)
    values: dict[str, object] = getattr(record, _KEY)
    return values


def trace_of(record: logging.LogRecord) -> str | None:
    """Return the traceback of a record; one that comes from another process has it as text."""
    return logging.Formatter().formatException(record.exc_info) if record.exc_info else record.exc_text


def _time(record: logging.LogRecord) -> str:
    return datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _quoted(value: object) -> str:
    """Return a value as text that a space or line end cannot break out of."""
    text = f"{value:.3f}" if isinstance(value, float) else without_secrets(str(value))
    is_plain = text.isprintable() and text and not set(text) & set(" \"'=")
    return text if is_plain else json.dumps(text, ensure_ascii=False)
