"""Malformed, oversized or foreign messages of peers: counted, logged once per kind and sender, dropped."""

import logging
from typing import Final

from atoll_core.errors import RemoteProtocolError
from atoll_core.logs import fields

MAX_SOURCES: Final = 1000
"""Most sources that are counted separately; further sources are counted together and not logged, to limit memory."""

OTHERS: Final = "elsewhere"


class Rejects:
    """A counter per source: the key of a message, which names its kind and its sender."""

    def __init__(self, logger: logging.Logger) -> None:
        self.counts: dict[str, int] = {}
        self._logger = logger

    @property
    def total(self) -> int:
        """Number of dropped messages."""
        return sum(self.counts.values())

    def count(self, source: str, error: RemoteProtocolError) -> None:
        """Count one dropped message that came from `source`; log the first of them."""
        source = source[:200]
        if source not in self.counts:
            if len(self.counts) < MAX_SOURCES:
                self._logger.warning("dropped message", extra=fields(source=source, reason=str(error)[:500]))
            else:
                source = OTHERS
        self.counts[source] = self.counts.get(source, 0) + 1
