"""What peers sent that was malformed, oversized or foreign: counted, logged once per kind and sender, dropped."""

import logging
from typing import Final

from atoll_core.errors import RemoteProtocolError
from atoll_core.logs import fields

MAX_SOURCES: Final = 1000
"""Sources told apart at most; further ones are counted together and not logged, so that a flood cannot fill memory."""

OTHERS: Final = "elsewhere"


class Rejects:
    """A counter per source: the key a message came on, which names both its kind and its sender."""

    def __init__(self, logger: logging.Logger) -> None:
        self.counts: dict[str, int] = {}
        self._logger = logger

    @property
    def total(self) -> int:
        """How many messages were dropped."""
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
