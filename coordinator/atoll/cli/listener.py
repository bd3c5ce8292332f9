"""A listener for others to connect to: the addresses at which they reach it, and who can do what there."""

import argparse
import contextlib
import ipaddress
import os
import socket
import struct
import sys
from pathlib import Path
from typing import Final

from atoll_core.errors import UsageError
from atoll_core.logs import configure
from atoll_core.wire.addresses import Address, Destination, destination, resolved
from atoll_core.wire.security.credentials import credentials_of
from atoll_core.wire.security.roles import RoleBindings, read_role_bindings

_EVERYWHERE: Final = ("0.0.0.0", "::")
_SIOCGIFADDR: Final = 0x8915
_LOCAL: Final = ("127.0.0.1", "localhost")


def read_options(options: argparse.Namespace, router: str | None = None) -> tuple[Destination, RoleBindings | None]:
    """Return where to listen, or the `router` to join, and who may do what; begin to log. Raises UsageError."""
    credentials = credentials_of(vars(options), os.environ, "serve" if router is None else "connect")
    wanted = destination(options.listen if router is None else router, credentials, listens=router is None)
    if wanted.others:
        option = "--listen" if router is None else "--router"
        raise UsageError(f"{option} takes one address, but {len(wanted.addresses)} were given: {wanted}")
    if options.roster is not None and credentials is None:
        raise UsageError(
            "--roster gives roles to the names in certificates, so it needs --tls-ca, --tls-cert and --tls-key"
        )
    if router is None:
        _require_dialable(wanted)
    role_bindings = None if options.roster is None else read_role_bindings(Path(options.roster))
    configure(options.log_format, options.log_level)
    return wanted, role_bindings


def warnings_of(at: Destination, role_bindings: RoleBindings | None) -> list[str]:
    """Return in plain words who can do what, where that is more than this machine's own programs."""
    if at.address.is_socket:
        return ["whoever may use that socket may submit, read and cancel jobs, and join as a worker"]
    if at.credentials is None and not is_loopback(at.address.host):
        return [
            f"NOT ENCRYPTED: whoever reaches port {at.address.port} may submit, read and cancel jobs, join as a",
            "worker or feed migrants in another's name; listen on a trusted network only, or on",
            "tls/HOST:PORT with --tls-ca, --tls-cert, --tls-key and --roster (deploy/tls/make-authority makes them)",
        ]
    if at.credentials is None:
        return []
    lines = [f"certificates: give each --tls-ca, --tls-cert and --tls-key; the authority is {at.credentials.authority}"]
    if role_bindings is None:
        lines.append(
            "no roster: whoever has a certificate of that authority may compute, submit and cancel (see --roster)"
        )
    return lines


def is_loopback(host: str) -> bool:
    """Tell whether only this machine can reach a listener on `host`."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def addresses_of(at: Destination, is_behind_router: bool = False) -> list[str]:
    """Return the addresses to connect to, those for other machines first; with a certificate those that it names."""
    address = at.address
    if is_behind_router or address.is_socket:
        return [str(address)]
    return [str(Address(address.protocol, host, address.port)) for host in _dialable_hosts(at)]


def own_address_of(at: Destination, is_behind_router: bool = False) -> str:
    """Return the address at which programs of this machine dial a listener of ours: where it listens.

    Of the names in its certificate that is the one that it listens on, else one of this machine; only where there is
    neither, the first, which may lead elsewhere.
    """
    address = at.address
    if is_behind_router or address.is_socket:
        return str(address)
    hosts = _dialable_hosts(at)
    host = next((host for host in (address.host, *_LOCAL, *heard_on(address.host)) if host in hosts), hosts[0])
    return str(Address(address.protocol, host, address.port))


def _require_dialable(at: Destination) -> None:
    """Raise UsageError where nobody could dial a listener by a name of its certificate."""
    address = at.address
    if address.is_socket or _dialable_hosts(at):
        return
    names = ", ".join(dict.fromkeys(at.credentials.hosts)) if at.credentials is not None else ""
    anywhere = "::" if ":" in address.host else "0.0.0.0"
    raise UsageError(
        f"nobody could dial a listener on {address}: its certificate has the names {names}, but an IPv4 address or a "
        f"host name that leads to {address.host} was expected; listen on "
        f"{Address(address.protocol, anywhere, address.port)}, or make a certificate with such a name "
        "(deploy/tls/make-authority DIR --coordinator HOST,...)"
    )


def _dialable_hosts(at: Destination) -> list[str]:
    """Return the hosts by which a listener is dialled: with a certificate the names in it that lead there.

    A name that is not known here, or leads elsewhere, may lead there from other machines, unless the listener is one
    for this machine alone.
    """
    address = at.address
    if at.credentials is None:
        return heard_on(address.host)
    names = dict.fromkeys(at.credentials.hosts)
    named = [host for host in names if Address(address.protocol, host, address.port).is_dialable]
    leading = [host for host in named if _leads(host, address.host)]
    if address.host in _EVERYWHERE:
        return [host for host in named if host in leading or resolved(host) is None]
    if leading or is_loopback(address.host):
        return leading
    return [host for host in named if not is_loopback(resolved(host) or host)]


def _leads(host: str, listener: str) -> bool:
    """Tell whether a host that is dialled from here leads to a listener of this machine, as far as is known here."""
    there = resolved(host)
    if there is None:
        return False
    if listener in _EVERYWHERE:
        return listener == "::" or ":" not in there
    return there == resolved(listener)


def heard_on(host: str) -> list[str]:
    """Return the addresses by which others reach a listener on `host`: all of this machine's for ``0.0.0.0``."""
    if host not in _EVERYWHERE:
        return [host]
    heard = [address for _, name in socket.if_nameindex() if (address := _interface_address(name))]
    others = [address for address in heard if not address.startswith("127.")]
    return [*others, "127.0.0.1"]


def _interface_address(name: str) -> str | None:
    """Return the IPv4 address of a network interface (Linux; elsewhere that of the host's name)."""
    with contextlib.suppress(OSError, ImportError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        if sys.platform == "linux":
            import fcntl

            answer = fcntl.ioctl(probe.fileno(), _SIOCGIFADDR, struct.pack("256s", name.encode()[:15]))
            return socket.inet_ntoa(answer[20:24])
        return socket.gethostbyname(socket.gethostname())
    return None
