"""When a worker asks to be let go. Plain data."""

from dataclasses import dataclass
from typing import Final

GRACE_S: Final = 30.0
"""How long handing over may take, unless another time was given."""


@dataclass(slots=True)
class Leaving:
    """When a worker asks to be let go (after `lifetime_s`, if given), and how long it waits for that at most.

    `is_wanted`: it has been told to end; `has_begun`: it has said so to the coordinator.
    """

    lifetime_s: float | None = None
    grace_s: float = GRACE_S
    is_wanted: bool = False
    has_begun: bool = False
