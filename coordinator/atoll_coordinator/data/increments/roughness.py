"""How rough the path of a state is: whether it has noise of its own, is driven by states that have, or is smooth. Pure.

High differences of a path leave next to nothing of what is smooth in time, and of noise all. Divided by what they are
of Brownian motion of rate one, the median of their squares is about the rate B of the noise, at any lag. A state that
only follows noisy ones is an integral of their noise: its increments over a step h vary as h^3 (h^5 if it follows such
a state, and so on), so that its rate grows fourfold with the lag doubled, where that of a state with noise of its own
stays. Letters: S states, N steps.
"""

import math
from typing import Final

import numpy as np

from atoll_coordinator.data.increments.steps import Steps, all_windows
from atoll_core.data.dataset import FloatArray

_STEPS: Final = 7
"""Steps of one difference, which is of the seventh order in the rows at their ends."""
_OWN: Final = 2.0
"""Growth of the rate with the lag doubled, as a factor: 1 for noise of a state's own, 4 for that of one it follows."""
_SMOOTH: Final = 2.0**10
"""The rate of what is smooth grows by 2^13, that of noise integrated four times by 2^8."""


def noise_shares(steps: Steps) -> FloatArray:
    """Return about how large noise is beside the median step, for each state (S,)."""
    shares = np.zeros(len(steps.increments))
    for state, increments in enumerate(steps.increments):
        step, rate = float(np.median(np.abs(increments))), noise_rate(steps, state)
        shares[state] = math.sqrt(rate * float(np.median(steps.lengths))) / step if step > 0.0 else math.inf
    return shares


def is_driven(steps: Steps, state: int) -> bool:
    """Tell whether a state moves by noise, but by none of its own."""
    rate = noise_rate(steps, state)
    return _OWN * rate < noise_rate(steps, state, lag=2) < _SMOOTH * rate


def noise_rate(steps: Steps, state: int, lag: int = 1) -> float:
    """Return about the variance per time that noise adds to a state, from rows `lag` apart; infinite without such.

    Of a path with noise of its own it is about 0.45 of that: the median of the square of a normal number.
    """
    differences = all_windows(steps, _STEPS, lag).differences(state)
    return float(np.median(differences * differences)) if len(differences) else math.inf
