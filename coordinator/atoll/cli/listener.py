"""A listener for others to connect to: the addresses at which they reach it, and who can do what there."""

import contextlib
import ipaddress
import socket
import struct
import sys
from pathlib import Path
from typing import Final

from atoll_core.errors import UsageError
from atoll_core.wire.addresses import Address, Destination
from atoll_core.wire.security.role_bindings import RoleBindings, read_role_bindings

_EVERYWHERE: Final = ("0.0.0.0", "::")
_SIOCGIFADDR: Final = 0x8915


def role_bindings_of(file: str | None, at: Destination) -> RoleBindings | None:
    """Return who may do what; None without a file. Raises UsageError."""
    if file is None:
        return None
    if at.credentials is None:
        raise UsageError(
            "--roster gives roles to the names in certificates, so it needs --tls-ca, --tls-cert and --tls-key"
        )
    return read_role_bindings(Path(file))


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
    address, files = at.address, at.credentials
    if is_behind_router or address.is_socket:
        return [str(address)]
    hosts = (files.hosts if files is not None else ()) or heard_on(address.host)
    return [str(Address(address.protocol, host, address.port)) for host in hosts]


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
