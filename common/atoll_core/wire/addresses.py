"""Addresses such as ``tcp/HOST:PORT``, ``tls/HOST:PORT`` or ``unixsock-stream/PATH``: parsing, probing, connect files.

A *destination* is an address with the credentials to use there, for listening or for dialling. A *connect file* holds
the addresses of a coordinator or router for programs that share a file system with it: one address per line, the most
useful first. It is written atomically once connections are accepted, and removed at a clean end. After a crash it may
be stale, so that an address counts only if a program accepts connections there.
"""

import contextlib
import errno
import os
import re
import socket
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from atoll_core.command_line import TLS_OPTIONS
from atoll_core.errors import NotNowError, RefusedError, UnreachableError, UsageError, may_pass
from atoll_core.wire.security.credentials import Credentials, check_welcome, speaks_tls

_PROTOCOLS: Final = ("tcp", "tls", "quic")
_SOCKET: Final = "unixsock-stream"
_LONGEST_PATH: Final = 103
"""Bytes of a socket's path that fit on every system (macOS has 104 with the final zero, Linux 108)."""
_NOT_IN_PATHS: Final = "?#\0\n"
"""Characters that end the path of an address for zenoh."""
_ENCRYPTED: Final = ("tls", "quic")
_PROBE_LIMIT_S: Final = 2.0
_BETWEEN: Final = re.compile(rf",(?=\s*(?:{'|'.join((*_PROTOCOLS, _SOCKET))})/)")
"""The comma between two addresses; the path of a socket may contain commas."""

MOST_BYTES: Final = 64 * 1024
"""Bytes of a connect file that are read."""
_PAUSE_S: Final = 0.2
_PROBE_S: Final = 1.0


@dataclass(frozen=True, slots=True)
class Address:
    """The address at which a router listens. Port 0 stands for any free port.

    For a Unix socket, which is open to the users of its folder, `host` is the path and `port` is 0.
    """

    protocol: str
    host: str
    port: int

    @property
    def is_socket(self) -> bool:
        """Whether the address is a Unix socket of this machine, not a network address."""
        return self.protocol == _SOCKET

    def __str__(self) -> str:
        if self.is_socket:
            return f"{self.protocol}/{self.host}"
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.protocol}/{host}:{self.port}"

    @property
    def is_dialable(self) -> bool:
        """Whether the bus can dial the address: the bus checks certificates by name or IPv4 address, not by IPv6."""
        return self.protocol not in _ENCRYPTED or ":" not in self.host

    @property
    def encrypted(self) -> str:
        """The text of this address with TLS."""
        written = Address("tls", self.host, self.port)
        return str(written) if written.is_dialable else f"tls/NAME:{self.port} with a NAME of its certificate"


@dataclass(frozen=True, slots=True)
class Destination:
    """An address, and the credentials to use there. Its text is the address alone.

    `others` are further addresses of the same service, such as a standby coordinator or a second router. They are tried
    one after another.
    """

    address: Address
    credentials: Credentials | None = None
    others: tuple[Address, ...] = ()

    @property
    def addresses(self) -> tuple[Address, ...]:
        """The first address, then the others."""
        return (self.address, *self.others)

    def __str__(self) -> str:
        return ",".join(str(address) for address in self.addresses)


def destination(text: str, credentials: Credentials | None = None, *, listens: bool = False) -> Destination:
    """Return the addresses that `text` names, separated by commas, with the credentials to use there.

    Raises:
        UsageError: a part is not an address; an encrypted address has no credentials, or an unencrypted address has
            some; or the address cannot be dialled, and this program does not listen there (`listens`).
    """
    addresses = addresses_in(text)
    for address in addresses:
        if credentials is None and address.protocol in _ENCRYPTED:
            names = ", ".join(f"{option} ({variable})" for option, (variable, _) in TLS_OPTIONS.items())
            raise UsageError(f"{address} needs certificates; give {names}")
        if credentials is not None and address.protocol not in _ENCRYPTED:
            raise UsageError(
                f"{address} is not encrypted, but TLS files were given; write {address.encrypted}, or leave out "
                "--tls-... and ATOLL_TLS_..."
            )
        if not listens and not address.is_dialable:
            raise UsageError(
                f"{address} cannot be dialled: with certificates, a name or an IPv4 address was expected; write "
                f"{address.encrypted}"
            )
    return Destination(addresses[0], credentials, addresses[1:])


def addresses_in(text: str) -> tuple[Address, ...]:
    """Return the addresses that `text` names, separated by commas; raises UsageError."""
    return tuple(dict.fromkeys(parse_address(part) for part in _BETWEEN.split(text)))


def parse_address(text: str) -> Address:
    """Return the address that `text` names; raises UsageError."""
    protocol, _, place = text.strip().partition("/")
    if protocol == _SOCKET:
        return _socket_address(text, place)
    host, _, port = place.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    good_port = port.isascii() and port.isdigit() and int(port) < 65536
    if protocol not in _PROTOCOLS or not host or not good_port or any(c in host for c in "/?#, "):
        raise UsageError(f"address {text!r} was found where tcp/HOST:PORT was expected, such as tcp/127.0.0.1:7447")
    return Address(protocol, host, int(port))


def _socket_address(text: str, path: str) -> Address:
    if not path:
        raise UsageError(f"address {text!r} was found where a path was expected, such as {_SOCKET}//tmp/mine/bus")
    if any(c in path for c in _NOT_IN_PATHS):
        raise UsageError(f"the path of {text!r} contains ?, # or a line break; name a socket in another folder")
    if len(os.fsencode(path)) > _LONGEST_PATH:
        raise UsageError(f"the path of {text!r} is longer than {_LONGEST_PATH} bytes; name a socket in another folder")
    return Address(_SOCKET, path, 0)


@contextlib.contextmanager
def own_address() -> Iterator[Address]:
    """Yield an address that only this user can reach, on this machine, while the block lasts: a socket in a folder."""
    with contextlib.ExitStack() as stack:
        try:
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="atoll-", ignore_cleanup_errors=True))
            if len(os.fsencode(folder)) > _LONGEST_PATH - len("/bus") or any(c in folder for c in _NOT_IN_PATHS):
                folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="atoll-", dir="/tmp"))
        except OSError as error:
            raise UsageError(
                f"no temporary folder can be made ({error.strerror}); name another place with TMPDIR"
            ) from error
        yield Address(_SOCKET, f"{folder}/bus", 0)


def bindable(address: Address) -> Address:
    """Return `address` with port 0 replaced by a free port, after checking that a router could listen there.

    Raises:
        UsageError: the port may not be used; NotNowError where it is in use, or the host is not (yet) this machine.
    """
    if address.is_socket:
        return _bindable_socket(address)
    kind = socket.SOCK_DGRAM if address.protocol == "quic" else socket.SOCK_STREAM
    try:
        family, _, _, _, place = socket.getaddrinfo(address.host, address.port, type=kind, flags=socket.AI_PASSIVE)[0]
        with socket.socket(family, kind) as probe:
            if kind == socket.SOCK_STREAM:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(place)
            return Address(address.protocol, address.host, probe.getsockname()[1])
    except OSError as error:
        passes = error.errno == socket.EAI_AGAIN if isinstance(error, socket.gaierror) else may_pass(error)
        raise (NotNowError if passes else UsageError)(_cannot_listen(address, error)) from error


def _cannot_listen(address: Address, error: OSError) -> str:
    if isinstance(error, socket.gaierror):
        reason = f"the host {address.host!r} is not known; try tcp/0.0.0.0:{address.port}"
    elif error.errno == errno.EADDRINUSE:
        reason = "the port is in use (is another coordinator running?); choose another with --listen"
    elif error.errno == errno.EADDRNOTAVAIL:
        reason = f"the host is not this machine; try tcp/0.0.0.0:{address.port}"
    else:
        reason = f"{(error.strerror or str(error)).lower()}; choose another with --listen"
    return f"cannot listen on {address}: {reason}"


def _bindable_socket(address: Address) -> Address:
    address = parse_address(f"{_SOCKET}/{Path(address.host).absolute()}")  # other programs dial it from other folders
    folder = Path(address.host).parent
    if not os.access(folder, os.W_OK | os.X_OK):
        raise UsageError(f"cannot listen on {address}: the folder {folder} is not there or cannot be written")
    if why_unreachable(address) is None:
        raise NotNowError(f"cannot listen on {address}: another program listens there; choose another with --listen")
    return address


def resolved(host: str) -> str | None:
    """Return the IP address that the bus uses for a host: the first one that the system returns; None: not known."""
    try:
        return str(socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)[0][4][0])
    except OSError:
        return None


def why_unreachable(address: Address, limit_s: float = _PROBE_LIMIT_S) -> str | None:
    """Return why `address` cannot be reached now, or None if a program accepts connections there."""
    if address.protocol == "quic":
        return None
    try:
        if address.is_socket:
            with socket.socket(socket.AF_UNIX) as probe:
                probe.settimeout(limit_s)
                probe.connect(address.host)
        else:
            socket.create_connection((address.host, address.port), timeout=limit_s).close()
    except socket.gaierror:
        return f"the host {address.host!r} is not known"
    except TimeoutError:
        return "there was no answer"
    except OSError as error:
        return (error.strerror or str(error)).lower()
    return None


def check_certificates(address: Address, credentials: Credentials | None, listen_s: float) -> str | None:
    """Return a problem with TLS at `address` other than certificates; None without a problem, or if it cannot be
    determined.

    Waits up to `listen_s` seconds for the other side to refuse our certificate.

    Raises:
        RefusedError: certificates do not match, or are required but missing.
    """
    if address.protocol == "quic" or address.is_socket:
        return None
    try:
        if credentials is not None:
            return check_welcome(address.host, address.port, credentials, listen_s)
        if speaks_tls(address.host, address.port):
            raise RefusedError(f"it asks for TLS; write {address.encrypted} and give {', '.join(TLS_OPTIONS)}")
    except RefusedError as error:
        raise RefusedError(f"no connection to the coordinator at {address}: {error}") from error
    return None


# -------------------------------------------------------------------------------------------------- connect files


@contextlib.contextmanager
def announced(path: Path | None, addresses: Sequence[str]) -> Iterator[None]:
    """Keep `addresses` in the connect file at `path` while the block lasts; without effect when `path` is None.

    Raises:
        UsageError: the file cannot be written; NotNowError where that may pass.
    """
    if path is None:
        yield
        return
    text = "".join(f"{address}\n" for address in addresses)
    draft = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        draft.write_text(text, "utf-8")
        draft.replace(path)  # atomically: readers find the old file, none, or all of the new one
    except OSError as error:
        raise (NotNowError if may_pass(error) else UsageError)(
            f"the addresses cannot be written to {path} ({error.strerror}); name another file with --connect-file"
        ) from error
    try:
        yield
    finally:
        with contextlib.suppress(OSError):  # another coordinator may have written its own file meanwhile
            if path.read_text("utf-8") == text:
                path.unlink()


def address_in(path: Path, wait_s: float) -> str:
    """Return the first address in the connect file at `path` that accepts connections, waiting up to `wait_s` seconds.

    The file may appear or be replaced during the wait.

    Raises:
        UnreachableError: no address accepted connections in time.
        UsageError: the file does not hold addresses.
    """
    end = time.monotonic() + wait_s
    while True:
        address, reason = _reachable(path)
        if address is not None:
            return address
        if time.monotonic() >= end:
            raise UnreachableError(
                f"no coordinator was found by the file {path} within {wait_s:g} s: {reason}; "
                "is `coordinator serve --connect-file` running, and is the file on a file system that both see?"
            )
        time.sleep(min(_PAUSE_S, max(0.0, end - time.monotonic())))


def _reachable(path: Path) -> tuple[str | None, str]:
    """Return the first address that can be reached now, or None and the reason."""
    try:
        with path.open("rb") as file:
            text = file.read(MOST_BYTES).decode("utf-8")
    except FileNotFoundError:
        return None, "it does not exist"
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"the file {path} cannot be read ({error}); name the one that `serve` writes") from error
    reasons = []
    for line in text.split():
        try:
            address = parse_address(line)
        except UsageError as error:
            raise UsageError(f"the file {path} holds no list of addresses: {error}") from error
        reason = why_unreachable(address, _PROBE_S)
        if reason is None:
            return str(address), ""
        reasons.append(f"{address}: {reason}")
    return None, ", ".join(reasons) or "it is empty"
