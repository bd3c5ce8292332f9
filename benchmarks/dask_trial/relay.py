"""A relay between a client and a scheduler that keeps what the client sends."""

import pickletools
import socket
import threading
from contextlib import suppress
from typing import Final, Self

_PART: Final = 1 << 16
_LIMIT_S: Final = 60.0


class Relay:
    """Passes bytes of any number of connections to ``host:port``; a context manager.

    `sent` is what came from clients.
    """

    def __init__(self, host: str, port: int) -> None:
        self.sent = bytearray()
        self._to = (host, port)
        self._door = socket.create_server(("127.0.0.1", 0))
        self.address: Final = f"tcp://127.0.0.1:{self._door.getsockname()[1]}"

    def __enter__(self) -> Self:
        threading.Thread(target=self._admit, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._door.close()

    def _admit(self) -> None:
        with suppress(OSError):
            while True:
                client, _ = self._door.accept()
                server = socket.create_connection(self._to, _LIMIT_S)
                threading.Thread(target=self._pass, args=(client, server, True), daemon=True).start()
                threading.Thread(target=self._pass, args=(server, client, False), daemon=True).start()

    def _pass(self, source: socket.socket, sink: socket.socket, is_kept: bool) -> None:
        with suppress(OSError), source, sink:
            while part := source.recv(_PART):
                if is_kept:
                    self.sent += part
                sink.sendall(part)


def pickled_calls(data: bytes) -> list[str]:
    """Return what the pickles in `data` import and call when they are read, each once."""
    names: dict[str, None] = {}
    place = data.find(b"\x80\x05")
    while place >= 0:
        strings: list[str] = []
        with suppress(Exception):  # most places that look like the beginning of a pickle are none
            for code, argument, _ in pickletools.genops(bytes(data[place:])):
                if isinstance(argument, str):
                    strings.append(argument)
                if code.name == "STACK_GLOBAL" and len(strings) >= 2:
                    names[".".join(strings[-2:])] = None
        place = data.find(b"\x80\x05", place + 2)
    return [*names]
