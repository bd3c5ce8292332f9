"""What no log, message or file is to show: tokens and passwords in addresses."""

import re
from typing import Final

_QUERY: Final = re.compile(r"""(https?://[^\s'"?#\\]*)\?[^\s'"#\\]*""", re.IGNORECASE)
_TOKEN: Final = re.compile(r"""([?&]token=|\bATOLL_WEB_TOKEN=)(?:\\*'[^']*'|\\*"[^"]*"|[^\s'"&#\\]+)""", re.IGNORECASE)
_PASSWORD: Final = re.compile(r"""(\b[a-z][a-z0-9+.-]*://)[^\s'"/@]+@""", re.IGNORECASE)
_BEARER: Final = re.compile(r"""(\bbearer\s+)[^\s'",\\]+""", re.IGNORECASE)


def without_secrets(text: str) -> str:
    """Return a text without the queries of HTTP addresses, tokens, and names with passwords before a host."""
    lower = text.lower()
    if "://" not in lower and "token=" not in lower and "bearer" not in lower:
        return text
    text = _PASSWORD.sub(r"\1", _QUERY.sub(r"\1", text))
    return _BEARER.sub(r"\1…", _TOKEN.sub(r"\1…", text))
