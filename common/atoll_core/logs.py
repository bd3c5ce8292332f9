"""Log lines: an event in a few words, then fields (job, variable, island, epoch, term, worker …), as text or as JSON.

All modules log through the standard library: ``_LOG.info("placed", extra=fields(job=job, term=3))``. Only the command
lines call `configure`.
"""

import json
import logging
import sys
from collections.abc import Mapping
from contextvars import ContextVar
from datetime import UTC, datetime
from types import MappingProxyType
from typing import Final

from atoll_core.redaction import redacted, without_secrets

_KEY: Final = "atoll_fields"
_HAS_CONTEXT: Final = "atoll_has_context"

_context: ContextVar[Mapping[str, object]] = ContextVar("fields of all log lines", default=MappingProxyType({}))


class about:  # read as a phrase: ``with about(job=job)``
    """Add these fields, such as `job` or `task`, to every line that is logged in this block; None adds nothing.

    A line's own fields take precedence over the fields of blocks, and inner blocks over outer blocks. The context
    belongs to the thread, or the asyncio task, that entered the block.
    """

    __slots__ = ("_token", "_values")

    def __init__(self, **values: object) -> None:
        self._values = values

    def __enter__(self) -> None:
        self._token = _context.set({**_context.get(), **_without_none(self._values)})

    def __exit__(self, *_: object) -> None:
        _context.reset(self._token)


def fields(**values: object) -> dict[str, object]:
    """Return the fields of a line as the argument `extra` of a log call; fields with the value None are left out."""
    return {_KEY: _without_none(values)}


def _without_none(values: Mapping[str, object]) -> dict[str, object]:
    return {name: value for name, value in values.items() if value is not None}


class TextLines(logging.Formatter):
    """``2026-01-01T00:00:00.000Z INFO placed job=a term=3 (atoll_coordinator.service.job_controller)``, on one line."""

    def __init__(self, context: dict[str, object]) -> None:
        """`context` are fields of every line."""
        super().__init__()
        self._context = context

    def format(self, record: logging.LogRecord) -> str:
        """Return the line, with a traceback below it if there is one."""
        values = " ".join(f"{name}={_quoted(value)}" for name, value in (self._context | fields_of(record)).items())
        line = " ".join(part for part in (_time(record), record.levelname, record.getMessage(), values) if part)
        text = f"{line} ({record.name})"
        trace = trace_of(record)
        return without_secrets(f"{text}\n{trace}" if trace else text)


class JsonLines(logging.Formatter):
    """One JSON object for each line: time, level, logger, event, then the fields."""

    def __init__(self, context: dict[str, object]) -> None:
        """`context` are fields of every line."""
        super().__init__()
        self._context = context

    def format(self, record: logging.LogRecord) -> str:
        """Return the line; a traceback is the field `exception`."""
        values = self._context | fields_of(record)
        values |= {"time": _time(record), "level": record.levelname.lower(), "logger": record.name}
        values |= {"event": record.getMessage()}
        if trace := trace_of(record):
            values["exception"] = trace
        return json.dumps(redacted(values), ensure_ascii=False)


def configure(
    form: str = "text", level: str = "info", handler: logging.Handler | None = None, **context: object
) -> None:
    """Send the log to `handler`, or to stderr, a line for each event from `level` on; every line has `context`."""
    handler = handler or logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonLines(context) if form == "json" else TextLines(context))
    handler.addFilter(with_context)
    logging.basicConfig(level=level.upper(), handlers=[handler], force=True)


def with_context(record: logging.LogRecord) -> bool:
    """Add the fields of `about` to a line, once: the line may be formatted later by another thread."""
    if not getattr(record, _HAS_CONTEXT, False):
        setattr(record, _KEY, {**_context.get(), **getattr(record, _KEY, {})})
        setattr(record, _HAS_CONTEXT, True)
    return True


def fields_of(record: logging.LogRecord) -> dict[str, object]:
    """Return the fields of a line."""
    with_context(record)
    values: dict[str, object] = getattr(record, _KEY)
    return values


def trace_of(record: logging.LogRecord) -> str | None:
    """Return the traceback of a record; a record from another process has it as text."""
    return logging.Formatter().formatException(record.exc_info) if record.exc_info else record.exc_text


def _time(record: logging.LogRecord) -> str:
    return datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _quoted(value: object) -> str:
    """Return a value as text, quoted if it has spaces, quotes, = or characters that cannot be printed."""
    text = f"{value:.3f}" if isinstance(value, float) else without_secrets(str(value))
    is_plain = text.isprintable() and text and not set(text) & set(" \"'=")
    return text if is_plain else json.dumps(text, ensure_ascii=False)
