"""Builds the ASGI application and serves it with uvicorn: addresses, users and their tokens, TLS for other machines."""

import contextlib
import ipaddress
import re
import socket
import stat
import tomllib
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import uvicorn
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Mount, Route, Router
from starlette.staticfiles import StaticFiles

from atoll.web.access import LOCAL_HOSTS, Access, AccessMiddleware, digest_of
from atoll.web.api import Api
from atoll.web.connections import WAIT_S, LimitedConnection, allow_open_files
from atoll.web.gateway import BusyError, Gateway
from atoll.web.problems import problem_of
from atoll.web.reading import Readers, remove_left
from atoll_core.errors import AtollError, NotNowError, UsageError, may_pass
from atoll_core.wire.addresses import Destination, destination
from atoll_core.wire.security.credentials import credentials_of

_STATIC: Final = files("atoll.web").joinpath("static")

_STOP_LIMIT_S: Final = 2

_ENTRY: Final = {"token_sha256", "tls_ca", "tls_cert", "tls_key"}
"""Required keys of each user in the file of users."""

_OTHERS: Final = stat.S_IRWXO | stat.S_IWGRP
"""File modes with which other users could read or change tokens. A group may read the file, such as a service's."""


@dataclass(frozen=True)
class Listener:
    """Address, port, other allowed host names, and the files for TLS."""

    host: str
    port: int
    names: Sequence[str] = ()
    certificate: str | None = None
    key: str | None = None

    @property
    def is_local(self) -> bool:
        """Whether only programs of this machine can reach the listener."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False

    def url(self, port: int) -> str:
        """Return the address for a browser, without a token."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        if host in ("0.0.0.0", "[::]"):
            host = socket.gethostname()
        return f"{'https' if self.certificate else 'http'}://{host}:{port}/"


def access_of(
    listener: Listener, at: Destination, token: str, users: Path | None, *, look_without_token: bool = False
) -> Access:
    """Return the access rules; with `look_without_token`, programs on this machine may read all jobs.

    Raises:
        UsageError: the file of users cannot be used; a certificate for connections from other machines is missing; or
            `look_without_token` would show jobs to other machines or to users who may not see all jobs.
    """
    is_own = listener.is_local and not listener.names and at.credentials is None and users is None
    if look_without_token and not is_own:
        raise UsageError(
            "--look-without-token shows all jobs to any user of the page, so it needs a --listen on this machine "
            "without --allow-host, --users and certificates of the bus; remove it, and give the token to users"
        )
    if not listener.is_local and listener.certificate is None:
        raise UsageError(
            f"--listen {listener.host} can be reached from other machines, which needs TLS; give --cert and --key, "
            "or listen on 127.0.0.1 behind a proxy"
        )
    own = Gateway(at)
    gateways = {digest_of(token): own} | (_gateways(users, at) if users is not None else {})
    hosts = {*LOCAL_HOSTS, *(host for name in (listener.host, *listener.names) for host in _hosts(name))}
    if not listener.is_local:
        hosts |= {socket.gethostname().lower(), socket.getfqdn().lower()}
    return Access(gateways, own if look_without_token else None, sorted(hosts))


def _hosts(name: str) -> tuple[str, ...]:
    """Return the forms of a name in a Host header; IPv6 addresses in brackets, as given and as browsers write them."""
    name = name.lower().removeprefix("[").removesuffix("]")
    try:
        address = ipaddress.ip_address(name)
    except ValueError:
        return (name,)
    return (name,) if address.version == 4 else (f"[{name}]", f"[{address.compressed}]")


def _gateways(file: Path, at: Destination) -> dict[str, Gateway]:
    """Return the gateways of users by the SHA-256 of their tokens, from a TOML file with a table per user: ``[ann]`` /
    ``token_sha256 = "…"`` / ``tls_cert = "ann.pem"`` / ``tls_key = "ann.key"`` / ``tls_ca = "ca.pem"``.
    """
    try:
        mode, text = file.stat().st_mode, file.read_text("utf-8")
        table: dict[str, Any] = tomllib.loads(text)
    except OSError as error:
        raise UsageError(f"--users {file} cannot be read: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"--users {file} is not valid TOML: {error}") from error
    if mode & _OTHERS:
        raise UsageError(f"--users {file} can be read by all users or changed by its group; run: chmod 600 {file}")
    if not table:
        raise UsageError(f"--users {file} names no user; add [NAME] with {', '.join(sorted(_ENTRY))}")
    gateways: dict[str, Gateway] = {}
    for name, entry in table.items():
        if (
            not isinstance(entry, dict)
            or set(entry) != _ENTRY
            or not all(isinstance(text, str) for text in entry.values())
        ):
            raise UsageError(f"--users {file}: {name} needs exactly the keys {', '.join(sorted(_ENTRY))}, as texts")
        token = entry["token_sha256"].lower()
        if not re.fullmatch("[0-9a-f]{64}", token) or token == digest_of(""):
            raise UsageError(
                f"--users {file}: token_sha256 of {name} is no SHA-256 of a token; run: printf %s TOKEN | sha256sum"
            )
        if token in gateways:
            raise UsageError(f"--users {file}: {name} has the token of another user; give each user another token")
        try:
            paths = {key: str(file.parent / entry[key]) for key in _ENTRY - {"token_sha256"}}
            credentials = credentials_of(paths, {}, "connect")
        except (UsageError, ValueError) as error:  # ValueError: a file name with a null byte
            raise UsageError(f"--users {file}: {name}: {error}") from error
        gateways[token] = Gateway(destination(str(at.address), credentials))
    return gateways


def serve(listener: Listener, access: Access, say: Callable[[str], object]) -> None:
    """Answer requests until SIGTERM or Ctrl-C.

    Raises:
        NotNowError: listening is impossible for a temporary reason, such as an address in use.
        UsageError: listening is impossible, or the certificate cannot be used.
    """
    allow_open_files()
    config = configure(build_application(access), listener)
    try:
        config.load()
    except OSError as error:  # also for a file that is not a certificate
        raise UsageError(
            f"--cert {listener.certificate} with --key {listener.key} cannot be used ({error.strerror or error}); "
            "give a certificate and its unencrypted key as PEM"
        ) from error
    family = socket.AF_INET6 if ":" in listener.host else socket.AF_INET
    opened = socket.socket(family)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        opened.bind((listener.host, listener.port))
    except OSError as error:
        opened.close()
        refused = NotNowError if may_pass(error) else UsageError
        raise refused(f"--listen {listener.host}:{listener.port} is not possible: {error.strerror}") from error
    say(listener.url(opened.getsockname()[1]))
    uvicorn.Server(config).run(sockets=[opened])


def configure(application: Any, listener: Listener) -> uvicorn.Config:
    """Return the configuration of uvicorn. It logs no requests, since they may hold a token, and no client errors."""
    return uvicorn.Config(
        application, log_level="error", access_log=False, server_header=False, date_header=False,
        timeout_graceful_shutdown=_STOP_LIMIT_S, timeout_keep_alive=int(WAIT_S), proxy_headers=False,
        h11_max_incomplete_event_size=64 * 1024, http=LimitedConnection, ws="none",
        ssl_certfile=listener.certificate, ssl_keyfile=listener.key,
        ssl_keyfile_password="-",  # otherwise OpenSSL would ask for a password on the terminal
    )  # fmt: skip


def build_application(access: Access, readers: Readers | None = None) -> Starlette:
    """Return the application; it closes its gateways when it ends."""
    readers = readers or Readers()
    api = Api(readers)

    @contextlib.asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        remove_left()
        with contextlib.suppress(OSError):  # the next request with a file reports the error
            readers.start()
        yield
        await api.close()
        for gateway in {*access.gateways.values(), *([access.viewer] if access.viewer is not None else [])}:
            gateway.close()

    application = Starlette(
        routes=[
            Route("/", _page),
            Mount("/api/v1", Router(api.routes(), redirect_slashes=False)),
            Mount("/static", StaticFiles(directory=str(_STATIC))),
        ],
        middleware=[Middleware(AccessMiddleware, access=access), Middleware(GZipMiddleware, minimum_size=1_000)],
        exception_handlers=dict.fromkeys((AtollError, HTTPException, BusyError), problem_of),
        lifespan=lifespan,
    )
    application.router.redirect_slashes = False  # a redirect would name an address that may differ behind a proxy
    return application


async def _page(request: Request) -> Response:
    return Response(_STATIC.joinpath("index.html").read_bytes(), media_type="text/html")
