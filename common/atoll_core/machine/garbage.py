"""How often Python looks for garbage in cycles."""

import gc
from typing import Final

_NEW_OBJECTS: Final = 20_000
_YOUNG_ROUNDS: Final = 20


def collect_rarely() -> None:
    """Look for garbage less often than Python would, from now on.

    Loading libraries makes hundreds of thousands of objects that stay. Looking at them again and again took a tenth of
    the time that loading takes.
    """
    gc.set_threshold(_NEW_OBJECTS, _YOUNG_ROUNDS, _YOUNG_ROUNDS)
