"""Sockets of a router, which are closed without a wait: the operating system sends what they still hold.

Zenoh sets SO_LINGER to 10 s on each of its TCP sockets. A socket is closed by one of the few threads that read the
messages of everybody. When the other side takes nothing (its process is stopped, its network is cut), that thread then
waits in ``close`` for 10 s, and the router reads nothing meanwhile. Zenoh has no setting for it, so that the option is
taken back on each socket as soon as its link is up. Without it, ``close`` returns at once, and what is left is sent all
the same, for as long as the other side takes it.
"""

import contextlib
import os
import socket
import struct
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Final

_FOLDERS: Final = (Path("/proc/self/fd"), Path("/dev/fd"))
_OFF: Final = struct.pack("ii", 0, 0)
_PAUSE_S: Final = 0.05
"""Between two looks at all sockets, so that a thousand clients that connect at once do not cause a thousand looks."""


class LingerRemover:
    """A thread that takes SO_LINGER back from the sockets of a router; it is told of each link that comes up."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._is_due = threading.Event()
        self._is_closed = threading.Event()
        threading.Thread(target=self._run, name="lingering sockets", daemon=True).start()

    def link_is_up(self) -> None:
        """Look for new sockets. From any thread; returns at once."""
        self._is_due.set()

    def close(self) -> None:
        """End the thread. Repeatable."""
        self._is_closed.set()
        self._is_due.set()

    def _run(self) -> None:
        while self._is_due.wait() and not self._is_closed.is_set():
            self._is_due.clear()
            for each in sockets_of(self._port):
                with contextlib.suppress(OSError):
                    each.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _OFF)
            self._is_closed.wait(_PAUSE_S)


def sockets_of(port: int) -> Iterator[socket.socket]:
    """Yield this process's TCP sockets of local `port`, by descriptors that are closed again; none on Windows."""
    folder = next((folder for folder in _FOLDERS if folder.is_dir()), None)
    for name in [path.name for path in folder.iterdir()] if folder is not None else []:
        try:
            copy = os.dup(int(name))  # whose socket stays the same, even when zenoh closes its own meanwhile
        except OSError:
            continue
        try:
            found = socket.socket(fileno=copy)
        except OSError:  # no socket
            os.close(copy)
            continue
        with found:
            if found.family in (socket.AF_INET, socket.AF_INET6) and found.type == socket.SOCK_STREAM:
                with contextlib.suppress(OSError):
                    if found.getsockname()[1] == port:
                        yield found
