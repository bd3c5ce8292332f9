"""A connection to a coordinator through ``coordinator web``, for users behind a firewall.

Each request of the bus becomes one HTTP request with the same contents. The web process pushes no changes, so clients
poll them every two seconds (`atoll.client.follower.QUIET_S`).
"""

import contextlib
import json
import re
import ssl
import time
import urllib.error
import urllib.request
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from urllib.parse import parse_qs, urlsplit

from atoll_core.errors import RefusedError, UnreachableError, UsageError
from atoll_core.wire import topics
from atoll_core.wire.addresses import Destination, destination
from atoll_core.wire.bus.interface import Event, Reply
from atoll_core.wire.messages.limits import MAX_MESSAGE
from atoll_core.wire.security.credentials import credentials_of

TOKEN: Final = "ATOLL_WEB_TOKEN"
"""Environment variable with the token. ``?token=`` in an address also works, but other users can read command lines."""

_TOKEN_FORM: Final = re.compile(r"[A-Za-z0-9._~+/-]+=*")
"""The tokens that RFC 6750, section 2.1, allows in headers; they include base64 in both alphabets."""

MESSAGE: Final = "application/vnd.atoll.message"

_REFUSED: Final = (400, 401, 403, 404, 405, 409, 413, 421, 422)


@dataclass(frozen=True, slots=True)
class WebAddress:
    """The address of ``coordinator web``; `authority` is a file of certificates trusted in addition to the system's."""

    base: str
    token: str = field(repr=False)
    authority: Path | None = None

    def __str__(self) -> str:
        return self.base


Whereabouts = Destination | WebAddress
"""The address of a coordinator: on the bus, or behind a web process."""


def coordinator_at(text: str, files: Mapping[str, object], environment: Mapping[str, str]) -> Whereabouts:
    """Return the address of a coordinator, on the bus or over HTTP.

    Args:
        text: one or several addresses such as ``tcp/host:7447``, or one address such as ``https://host:7480``.
        files: options for TLS by name, such as `tls_ca`.
        environment: defaults for the options.

    Raises:
        UsageError: the address is invalid, or a file or token is missing.
    """
    if not text.startswith(("http://", "https://")):
        return destination(text, credentials_of(files, environment, "connect"))
    parts = urlsplit(text)
    token = parse_qs(parts.query).get("token", [environment.get(TOKEN, "")])[0]
    if not parts.hostname or not token:
        what = "no host" if not parts.hostname else "no token"
        raise UsageError(
            f"{parts.scheme}://{parts.netloc} has {what}; give the address of coordinator web, and its token in {TOKEN}"
        )
    check_token(token)
    authority = files.get("tls_ca") or environment.get("ATOLL_TLS_CA")
    return WebAddress(f"{parts.scheme}://{parts.netloc}{parts.path.rstrip('/')}", token, _file(authority))


def check_token(token: str) -> None:
    """Raise UsageError for a token with characters that are not allowed in headers."""
    if not _TOKEN_FORM.fullmatch(token):
        raise UsageError(
            f"the token of the page has other characters than letters, digits, - . _ ~ + /, and = at its end; set "
            f"{TOKEN} to another one, such as the output of: openssl rand -hex 24"
        )


def _file(name: object) -> Path | None:
    return Path(str(name)) if name else None


class HttpBus:
    """The part of a bus that a `Client` needs, over HTTP."""

    def __init__(self, address: WebAddress) -> None:
        """Raises UsageError if the file of certificates cannot be used."""
        self._address = address
        self._replies: deque[Reply] = deque()
        self._token = 0
        self._context: ssl.SSLContext | None = None
        if address.base.startswith("https:"):
            try:
                self._context = ssl.create_default_context(cafile=address.authority and str(address.authority))
            except OSError as error:
                raise UsageError(f"the certificates in {address.authority} cannot be used: {error}") from error

    def subscribe(self, key_expression: str) -> None:
        """Do nothing, because followers poll."""

    def get(self, key: str, payload: bytes = b"", timeout_s: float = 5.0) -> int:
        """Send a request to the web process, which passes it to the coordinator under its own name."""
        self._token += 1
        answer = self._post(payload, timeout_s) if key != topics.HELLO else None
        self._replies.append(Reply(self._token, answer))
        return self._token

    def receive(self, timeout_s: float) -> Event | None:
        """Return the next answer; None after `timeout_s`."""
        if self._replies:
            return self._replies.popleft()
        time.sleep(max(0.0, timeout_s))
        return None

    def now(self) -> float:
        """Return monotonic seconds."""
        return time.monotonic()

    def _post(self, payload: bytes, limit_s: float) -> bytes | None:
        headers = {"Authorization": f"Bearer {self._address.token}", "Content-Type": MESSAGE}
        request = urllib.request.Request(f"{self._address.base}/api/v1/messages", payload, headers, method="POST")
        try:
            with urllib.request.urlopen(request, timeout=max(limit_s, 1.0), context=self._context) as answer:
                body: bytes = answer.read(MAX_MESSAGE + 1)
                return body if answer.headers.get_content_type() == MESSAGE else None
        except urllib.error.HTTPError as error:
            sentence = _detail(error)
            if error.code in _REFUSED:
                raise RefusedError(sentence) from error
            raise UnreachableError(sentence) from error
        except TimeoutError:
            return None
        except OSError as error:
            reason = getattr(error, "reason", error)
            raise UnreachableError(f"nothing answers at {self._address.base}: {reason}") from error


def _detail(error: urllib.error.HTTPError) -> str:
    """Return the detail of a problem response (RFC 9457); other responses may come from a proxy."""
    with contextlib.suppress(ValueError, AttributeError, OSError):
        detail = json.loads(error.read(MAX_MESSAGE)).get("detail")
        if isinstance(detail, str):
            return detail
    return f"the web server answered {error.code} {error.reason}; check the address"
