"""How sure one is which of two equations is right, in words."""

import math
from typing import Final

UNDECIDED: Final = 3.0
DECIDED: Final = 20.0
"""Odds below which data do not decide between two, and from which they do.

By Kass and Raftery (1995, doi 10.1080/01621459.1995.10476572) odds below 3 are "not worth more than a bare mention",
and those from 20 on strong.
"""
_MOST_ODDS: Final = 1e6
_SUREST: Final = 0.999
_NOTHING: Final = 0.01
"""Nats that are no difference."""


def odds_text(odds: float) -> str:
    """Return odds of at least 1 as a number of times, bounded."""
    if odds >= _MOST_ODDS:
        return "more than a million times"
    return f"{odds:.2g} times" if odds < 100.0 else f"{float(f'{odds:.1g}'):,.0f} times"


def which_of_two(first: str, second: str, nats: float) -> str:
    """Return which of two candidates the data favour, and how strongly, in a sentence.

    Args:
        first: what one candidate is called.
        second: what the other is called.
        nats: logarithm of the odds for the first; negative where the data favour the second.
    """
    if nats < 0.0:
        return which_of_two(second, first, -nats)
    if nats < _NOTHING:
        return f"{first} and {second} describe the data equally well."
    odds = math.exp(min(nats, 2.0 * math.log(_MOST_ODDS)))
    shares = "" if odds >= 100.0 else f" ({100.0 * odds / (1.0 + odds):.0f} to {100.0 / (1.0 + odds):.0f} %)"
    by = f"{first} is {odds_text(odds)} as probable as {second}{shares}"
    if odds < UNDECIDED:
        return f"The data do not decide between {first} and {second}: {by}, if one of them is right."
    strongly = "decide for" if odds >= DECIDED else "favour, without deciding for it,"
    return f"The data {strongly} {first}: {by}, if one of them is right."


def certainty_text(certainty: float) -> str:
    """Return a lower bound of a probability, never rounded up."""
    if certainty >= _SUREST:
        return f"more than {100.0 * _SUREST:.1f} %"
    return f"at least {math.floor(100.0 * certainty):.0f} %"
