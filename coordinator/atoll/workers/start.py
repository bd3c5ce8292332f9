"""`start_on`: what it is given is checked here, before anything is sent to a cluster."""

import importlib
from collections.abc import Callable, Mapping
from numbers import Integral, Real
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from atoll.workers.handle import Handle
from atoll.workers.program import ProgramOptions
from atoll_core.errors import UsageError
from atoll_core.quoting import shown
from atoll_core.wire.addresses import parse_address

WAIT_S: Final = 60.0
"""How long the coordinator may be away; it is started again within that."""

GRACE_S: Final = 30.0
"""As of ``island-worker --grace``."""

MOST_PROCESSES: Final = 1024
"""As of ``island-worker --processes``."""

Start = Callable[[Any, ProgramOptions, int | None], Handle]
"""Starts workers on a cluster, given a client of it, what the program is told and how many processes a machine has."""

_LONGEST_S: Final = 1e9
_TLS: Final = ("ca", "cert", "key")
_DASK_SCHEMES: Final = ("tcp", "tls", "ucx", "ws", "wss", "inproc")


def start_on(
    client: object,
    *,
    connect: str,
    workers: int | None = None,
    tls: Mapping[str, str | Path] | None = None,
    wait: float = WAIT_S,
    grace: float = GRACE_S,
) -> Handle:
    """Start island workers on the machines of a Dask or a Ray cluster, also on those that join it later.

    Each Dask worker or Ray node starts one program ``island-worker``, which ends with it. Atoll is installed there, in
    the same version. Machines that leave the cluster in order have their islands handed over first; those that are
    killed cost a second or two of their work, and no result.

    Args:
        client: a ``distributed.Client`` or a Dask scheduler's address such as ``tcp://host:8786``; or the module
            ``ray`` after ``ray.init``, or a Ray address such as ``auto`` or ``ray://host:10001``.
        connect: the coordinator as the machines of the cluster reach it, such as ``tcp/host:7447``.
        workers: processes on each Dask worker or Ray node; None: one for each of its threads, or CPUs.
        tls: files by ``ca``, ``cert`` and ``key`` for an address ``tls/…``, as they are called on those machines;
            None: what their environment names.
        wait: seconds for which the coordinator may be away.
        grace: seconds within which islands are handed over.

    Returns:
        What ends them: ``close()``, or the end of a ``with`` block.

    Raises:
        UsageError: an argument is wrong, or dask or ray is missing.
        AtollError: the cluster does not do it.
    """
    options = _options(connect, tls, wait, grace)
    if workers is not None and (
        isinstance(workers, bool) or not isinstance(workers, Integral) or not 1 <= workers <= MOST_PROCESSES
    ):
        raise UsageError(f"workers must be a whole number from 1 to {MOST_PROCESSES}, but {shown(workers)} was given")
    number = None if workers is None else int(workers)
    if _is_dask(client):
        return _starter("dask", "distributed")(client, options, number)
    if isinstance(client, str) or (isinstance(client, ModuleType) and client.__name__ == "ray"):
        return _starter("ray", "ray")(client, options, number)
    raise UsageError(
        "a distributed.Client, the module ray, or the address of a cluster was expected as the first argument, but "
        f"{shown(client)} was given"
    )


def _is_dask(client: object) -> bool:
    if isinstance(client, str):
        scheme, separator, _ = client.partition("://")
        return bool(separator) and scheme in _DASK_SCHEMES
    return any(kind.__module__ == "distributed.client" and kind.__name__ == "Client" for kind in type(client).__mro__)


def _starter(name: str, package: str) -> Start:
    """Return what starts workers on one kind of cluster; raises UsageError where its package is missing."""
    try:
        importlib.import_module(package)
    except ImportError as error:
        raise UsageError(
            f"{package} is not installed, which workers on such a cluster need; pip install 'atoll[{name}]'"
        ) from error
    start: Start = importlib.import_module(f"atoll.workers.{name}_cluster").start
    return start


def _options(connect: object, tls: object, wait: object, grace: object) -> ProgramOptions:
    if not isinstance(connect, str):
        raise UsageError(f"connect must be an address such as 'tcp/HOST:7447', but {shown(connect)} was given")
    address = parse_address(connect)
    if tls is not None and not (isinstance(tls, Mapping) and set(tls) == set(_TLS)):
        raise UsageError(f"tls must have the files {', '.join(_TLS)} by these names, but {shown(tls)} was given")
    if tls is not None and address.protocol not in ("tls", "quic"):
        raise UsageError(f"{address} is not encrypted, but tls was given; write tls/HOST:PORT, or leave out tls")
    files = {name: str(file) for name, file in (tls or {}).items()}
    return ProgramOptions(str(address), _seconds("wait", wait), _seconds("grace", grace), files)


def _seconds(name: str, value: object) -> float:
    if isinstance(value, Real) and not isinstance(value, bool) and 0.0 <= float(value) < _LONGEST_S:
        return float(value)
    raise UsageError(f"{name} must be a number of seconds, at least 0, but {shown(value)} was given")
