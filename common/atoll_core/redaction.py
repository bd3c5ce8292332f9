"""Removes secrets from logs, messages and files: tokens, and passwords in addresses."""

import re
from typing import Final

_WORD: Final = r"""(?:\\*'[^']*'|\\*"[^"]*")?\S*?(?=\\*['"]?[,;:)\]}>]{0,3}(?:\s|$))"""
"""The rest of a word, perhaps quoted, without closing punctuation."""

_TOKEN: Final = re.compile(rf"""([?&#;]token=|\bATOLL_WEB_TOKEN["']?\s*[=:]\s*(?=\S)){_WORD}""", re.IGNORECASE)
_HEADER: Final = re.compile(
    rf"""(\bauthorization["']?\s*[=:]\s*["']?(?:(?:basic|bearer|digest|negotiate|token)\s+)?(?=\S)){_WORD}""",
    re.IGNORECASE,
)
_BEARER: Final = re.compile(rf"""(\bbearer\s+(?=\S)){_WORD}""", re.IGNORECASE)
_PASSWORD: Final = re.compile(
    r"""(\b[a-z][a-z0-9+.-]{0,15}://)(?:[^\s/@:]{0,128}:\S{0,256}@|[^\s'"/@]{1,256}@)""", re.IGNORECASE
)
_QUERY: Final = re.compile(r"""(https?://[^\s'"?#\\]*)\?[^\s'"#\\]*""", re.IGNORECASE)
_SIGNS: Final = ("://", "token", "bearer", "authorization")


def without_secrets(text: str) -> str:
    """Return a text without the queries of HTTP addresses, tokens, and names with passwords before a host.

    The whole word of a token is removed, regardless of its characters. Words end differently in JSON: see `redacted`.
    """
    lower = text.lower()
    if not any(sign in lower for sign in _SIGNS):
        return text
    for secret in (_TOKEN, _HEADER, _BEARER):
        text = secret.sub(r"\1…", text)
    return _QUERY.sub(r"\1", _PASSWORD.sub(r"\1", text))


def redacted(value: object) -> object:
    """Return plain data without secrets in its texts, before it becomes JSON; other objects as texts."""
    if value is None or isinstance(value, (bool, int, float)):
        return value
    if isinstance(value, dict):
        return {str(key): redacted(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [redacted(part) for part in value]
    return without_secrets(str(value))
