"""The counter-based random generator of `atoll_core.search.seeding` for kernels.

The state of a stream is one uint64, in an array of length 1.
"""

import numpy as np
import numpy.typing as npt

from atoll_core.compilation.jit import inlined
from atoll_core.expression.kernels.elementary import strict_cos, strict_log
from atoll_core.expression.kernels.tape import Int
from atoll_core.search.seeding import GAMMA as _GAMMA

Stream = npt.NDArray[np.uint64]

GAMMA = np.uint64(_GAMMA)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S32, _S11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(32), np.uint64(11)


@inlined
def bits_of(z: np.uint64) -> np.uint64:
    """Return the 64 random bits of a stream in state `z`: the finaliser of SplitMix64 (Steele, Lea & Flood 2014)."""
    z = (z ^ (z >> _S30)) * _FIRST
    z = (z ^ (z >> _S27)) * _SECOND
    return z ^ (z >> _S31)


@inlined
def next_bits(stream: Stream) -> np.uint64:
    """Return the next 64 random bits and advance the stream."""
    stream[0] += GAMMA
    return bits_of(stream[0])


@inlined
def below(stream: Stream, bound: Int) -> Int:
    """Return a random integer in [0, bound), bound < 2**32."""
    return np.int64(((next_bits(stream) >> _S32) * np.uint64(bound)) >> _S32)


@inlined
def uniform(stream: Stream) -> float:
    """Return a random float in [0, 1) with 53 random bits."""
    return np.float64(next_bits(stream) >> _S11) * 1.1102230246251565e-16


@inlined
def normal(stream: Stream) -> float:
    """Return a random number with standard normal distribution (Box & Muller 1958), from two draws."""
    radius = np.sqrt(-2.0 * strict_log(1.0 - uniform(stream)))
    return radius * strict_cos(6.283185307179586 * uniform(stream))
