"""The only module that makes random streams. Each stream has a name and one purpose; no library generator is used.

The generator is counter-based: draw n of a stream is ``mix(key + (n + 1) * GAMMA)``, with the finaliser of SplitMix64
(Steele, Lea & Flood 2014, figure 14). The state of a stream is therefore one uint64. Checkpoints contain no streams,
because the key of each stream is computed from its name (see `stream_key`).
"""

import hashlib
from typing import Final

GAMMA: Final = 0x9E3779B97F4A7C15
_MASK: Final = 2**64 - 1


def stream_key(seed: int, variable: str, island: int, epoch: int, purpose: str) -> int:
    """Return the 64-bit key of the stream for `purpose`; `island` is -1 for streams that all islands share."""
    text = f"{seed}\x1f{variable}\x1f{island}\x1f{epoch}\x1f{purpose}"
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=8).digest(), "little")


class Stream:
    """The same generator as in the kernels, for other code. It is pure Python, for a few draws at a time."""

    def __init__(self, key: int) -> None:
        self._state = key & _MASK

    def bits(self) -> int:
        """Return the next 64 random bits."""
        self._state = (self._state + GAMMA) & _MASK
        z = self._state
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & _MASK
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & _MASK
        return z ^ (z >> 31)

    def below(self, bound: int) -> int:
        """Return an integer in [0, bound), by multiplication of the high 32 bits (bound < 2**32)."""
        return ((self.bits() >> 32) * bound) >> 32

    def uniform(self) -> float:
        """Return a float in [0, 1) with 53 random bits."""
        return (self.bits() >> 11) * 2.0**-53

    def permutation(self, length: int) -> list[int]:
        """Return a random permutation of range(length) by Fisher and Yates' shuffle."""
        order = list(range(length))
        for last in range(length - 1, 0, -1):
            other = self.below(last + 1)
            order[last], order[other] = order[other], order[last]
        return order
