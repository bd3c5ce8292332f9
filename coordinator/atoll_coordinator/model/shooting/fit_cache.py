"""What has been fitted before, so that nothing is fitted twice: a descent comes back to the same systems.

What is remembered is equal to the bit to what another fit would give, and counts the same work.
"""

import threading
from collections import OrderedDict
from typing import Final, Generic, TypeVar

from atoll_coordinator.model.shooting.error_model import ErrorModel
from atoll_coordinator.model.shooting.system import System
from atoll_core.data.dataset import FloatArray

_ROOM_BYTES: Final = 64_000_000
"""Fits that are remembered take about so much together; beyond, the oldest go."""

Key = tuple[object, ...]
Fit = TypeVar("Fit")


def key_of(system: System, starts: FloatArray | None, errors: ErrorModel | None, *rest: object) -> Key:
    """Return what a fit is known by: all that decides what comes of it, to the bit."""
    arrays = (*system.arrays(), starts)
    known = None if errors is None else errors.to_bytes()
    return (*(None if array is None else array.tobytes() for array in arrays), known, *rest)


class FitCache(Generic[Fit]):
    """Remembers fits by their keys. Any thread may use it."""

    def __init__(self, size_bytes: int, room_bytes: int = _ROOM_BYTES) -> None:
        """`size_bytes` is about what one fit takes."""
        self._most: Final = max(1, room_bytes // size_bytes)
        self._fits: Final[OrderedDict[Key, Fit]] = OrderedDict()
        self._lock: Final = threading.Lock()

    def get(self, key: Key) -> Fit | None:
        """Return the fit of this key, None when it is not remembered."""
        with self._lock:
            return self._fits.get(key)

    def put(self, key: Key, fit: Fit) -> None:
        """Remember a fit."""
        with self._lock:
            self._fits[key] = fit
            if len(self._fits) > self._most:
                self._fits.popitem(last=False)
