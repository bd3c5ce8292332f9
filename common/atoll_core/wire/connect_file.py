"""The file in which a coordinator or router leaves its addresses for those who share a file system with it.

One address a line, the most useful first. It is there, whole, once connections are accepted, and removed at a clean
end; after another end it may be stale, so that an address counts only when something accepts connections there.
"""

import contextlib
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from atoll_core.errors import NotNowError, UnreachableError, UsageError, may_pass
from atoll_core.wire.addresses import parse_address, why_unreachable

MOST_BYTES: Final = 64 * 1024
_PAUSE_S: Final = 0.2
_PROBE_S: Final = 1.0


@contextmanager
def announced(path: Path | None, addresses: Sequence[str]) -> Iterator[None]:
    """Keep `addresses` in the file at `path` while the block lasts; without effect when it is None.

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
        draft.replace(path)  # whole or not at all: who reads it meanwhile finds the old one, or none
    except OSError as error:
        raise (NotNowError if may_pass(error) else UsageError)(
            f"the addresses cannot be written to {path} ({error.strerror}); name another file with --connect-file"
        ) from error
    try:
        yield
    finally:
        with contextlib.suppress(OSError):  # another coordinator may have left its own there meanwhile
            if path.read_text("utf-8") == text:
                path.unlink()


def address_in(path: Path, wait_s: float) -> str:
    """Return the first address in the file at `path` where connections are accepted, waiting up to `wait_s` seconds.

    The file may come, or be replaced, while it is waited for.

    Raises:
        UnreachableError: there was none in time.
        UsageError: the file holds something else than addresses.
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
    """Return the first address that can be reached now, or None and why not."""
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
