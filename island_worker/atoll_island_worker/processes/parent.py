"""That no process outlives the one it belongs to.

A child is forked from this process, or a fresh interpreter where that cannot be, in a session of its own, so that a
Ctrl-C on the terminal reaches the parent alone, which tells the children. Should the parent die without a word, the
kernel (on Linux) and a watching thread end the child.
"""

import ctypes
import os
import signal
import sys
import threading
import time
from typing import Final

_STOP_LIMIT_S: Final = 5.0
_WATCH_INTERVAL_S: Final = 1.0
_PR_SET_PDEATHSIG: Final = 1


def end_with_parent(parent: int) -> None:
    """End this process, by a SIGTERM to itself, as soon as `parent` is no longer its parent; if need be, forcibly."""
    request_parent_death_signal()
    threading.Thread(target=_watch, args=(parent,), name="watching the parent", daemon=True).start()


def request_parent_death_signal() -> None:
    """Have the system send this process a SIGTERM when its parent dies, at once; on Linux only, and not for sure."""
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_WATCH_INTERVAL_S)
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(_STOP_LIMIT_S)
    os._exit(1)
