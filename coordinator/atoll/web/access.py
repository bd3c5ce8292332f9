"""Access to the web process: allowed hosts, origins of pages, bearer tokens. It is the outermost ASGI middleware.

Requests about jobs need a token, unless ``--look-without-token`` lets programs of this machine read without one. The
page uses no cookies, so that no other page can act with a browser's credentials. Requests from pages of other sites are
refused nevertheless. This includes read-only requests, because an answer may cost the coordinator seconds.
"""

import hashlib
import hmac
import os
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from atoll.client.over_http import TOKEN, check_token
from atoll.web.gateway import Gateway
from atoll.web.problems import ProblemDetails
from atoll_core.errors import UsageError

SAFE: Final = ("GET", "HEAD")
"""HTTP methods for reading; all other methods need a token."""

LOCAL_HOSTS: Final = ("localhost", "127.0.0.1", "[::1]")

_OPEN: Final = ("/", "/static/", "/api/v1/openapi.json", "/api/v1/version", "/api/v1/session", "/api/v1/health")
"""Paths that give no information on jobs, and so need no token."""

_ONCE: Final = ("authorization", "host", "origin", "sec-fetch-site")
"""Headers that decide on access; each may occur once."""

_POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS: Final[Mapping[str, str]] = {
    "content-security-policy": _POLICY,
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}


@dataclass(frozen=True)
class Access:
    """Which requests are allowed, and as which user.

    `gateways` has a gateway (one user of the coordinator) for the SHA-256 of each token. `viewer` is the gateway for
    requests without a token (None: such requests are refused). `hosts` are the allowed host names of the process.
    """

    gateways: Mapping[str, Gateway]
    viewer: Gateway | None
    hosts: Sequence[str]

    def gateway_of(self, authorization: str) -> Gateway | None:
        """Return the gateway of a bearer token; None if the token is unknown."""
        scheme, _, token = authorization.partition(" ")
        if scheme.lower() != "bearer":
            return None
        digest = digest_of(token.strip())
        found = [gateway for known, gateway in self.gateways.items() if hmac.compare_digest(known, digest)]
        return found[0] if found else None

    def problem(self, method: str, path: str, headers: Headers) -> ProblemDetails | None:
        """Return the reason to refuse a request, or None if it is allowed."""
        twice = next((name for name in _ONCE if len(headers.getlist(name)) > 1), None)
        if twice is not None or ("transfer-encoding" in headers and "content-length" in headers):
            sentence = (
                f"the header {twice} occurs twice" if twice else "content-length and transfer-encoding both occur"
            )
            return ProblemDetails(
                400,
                sentence + ", so a proxy may interpret the request differently; send only one of them",
                {"connection": "close"},
            )
        host = _name(headers.get("host", ""))
        if host not in self.hosts:
            return ProblemDetails(
                421, f"the host name {host!r} is not allowed; start coordinator web with --allow-host {host or 'NAME'}"
            )
        if (method not in SAFE or path.startswith("/api")) and _is_foreign(headers):
            return ProblemDetails(
                403, "requests from a page of another origin are refused; open the page at its own address"
            )
        authorization = headers.get("authorization")
        if authorization is not None and self.gateway_of(authorization) is None:
            return _unauthorized_problem("the token is unknown; open the address that coordinator web has printed")
        if authorization is None and (
            method not in SAFE or (self.viewer is None and not (path in _OPEN or path.startswith("/static/")))
        ):
            return _unauthorized_problem(
                "this request needs a token; open the address that coordinator web has printed"
            )
        return None


def digest_of(token: str) -> str:
    """Return the SHA-256 of a token, in hexadecimal."""
    return hashlib.sha256(token.encode()).hexdigest()


def token_of(environment: Mapping[str, str] = os.environ) -> str:
    """Return the token of the environment, or a random one; raises UsageError if it is short or unfit for a header."""
    token = environment.get(TOKEN)
    if token is None:
        return secrets.token_urlsafe(24)
    if len(token) < 16:
        raise UsageError(f"{TOKEN} has {len(token)} characters, but at least 16 were expected; set a longer one")
    check_token(token)
    return token


def gateway_of(request: Request) -> Gateway:
    """Return the gateway of the user who sent a request; requests without a gateway have been refused before."""
    gateway: Gateway = request.scope["gateway"]
    return gateway


class AccessMiddleware:
    """Refuses requests that are not allowed, and adds security headers to every answer."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app = app
        self._access = access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        scope["may_write"] = headers.get("authorization") is not None
        scope["gateway"] = self._access.gateway_of(headers.get("authorization", "")) or self._access.viewer
        path = scope["path"].removeprefix(scope.get("root_path", ""))
        problem = self._access.problem(scope["method"], path, headers)

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                given = {name for name, _ in message["headers"]}
                added = [(name.encode(), value.encode()) for name, value in _HEADERS.items()]
                message["headers"] = [*message["headers"], *(pair for pair in added if pair[0] not in given)]
            await send(message)

        await (problem or self._app)(scope, receive, send_with_headers)


def _name(host: str) -> str:
    """Return the name in a Host header, without the port."""
    name, colon, port = host.lower().rpartition(":")
    return name if colon and port.isdigit() else host.lower()


def _is_foreign(headers: Headers) -> bool:
    """Return whether a page of another origin sent the request, according to its headers.

    Without `sec-fetch-site`, host names are compared, but not ports, because proxies may change them.
    """
    site = headers.get("sec-fetch-site")
    if site is not None:
        return site not in ("same-origin", "none")
    origin = headers.get("origin")
    return origin is not None and _name(origin.partition("://")[2]) != _name(headers.get("host", ""))


def _unauthorized_problem(sentence: str) -> ProblemDetails:
    return ProblemDetails(401, sentence, {"www-authenticate": "Bearer"})
