"""Rows that are the steps of a map x(n + 1) = f(x(n)) rather than samples of a motion. Pure."""

from collections.abc import Iterator

import numpy as np

from atoll_coordinator.data.columns.finding import Columns, Finding
from atoll_coordinator.data.columns.neighbours import disagreement, neighbours
from atoll_coordinator.data.columns.sums import roughness
from atoll_coordinator.settings import SETTINGS

LIMITS = SETTINGS.columns


def check_map(columns: Columns) -> Iterator[Finding]:
    """Yield a finding where states jump from row to row, and yet the next row follows from each."""
    states = columns.roles.states
    if not columns.is_in_time or columns.config.data.stochastic or not 0 < len(states) <= LIMITS.most_positions:
        return
    is_jumping = all(roughness(columns.values[name]) > LIMITS.jumps for name in states)
    if not is_jumping or not all(_follows(columns, name) for name in states):
        return
    named = " and ".join(f"'{name}'" for name in states)
    yield Finding(
        f"{named} jump{'s' if len(states) == 1 else ''} from row to row, yet each row decides the next, as in "
        "steps of a map x(n + 1) = f(x(n)) or where a period has few rows",
        f"sample more often, or, if it is a map, write the next row's value beside each, as '{states[0]}_next', and "
        f"use --target {states[0]}_next",
    )


def _follows(columns: Columns, name: str) -> bool:
    """Say whether rows with nearly the same states have nearly the same next row."""
    values, roles = columns.values, columns.roles
    part = np.concatenate([np.full(len(along) - 1, place, np.int64) for place, along in enumerate(columns.times)])
    now = [np.concatenate([along[:-1] for along in values[other]]) for other in (*roles.states, *roles.inputs)]
    after = np.concatenate([along[1:] for along in values[name]])
    is_there = np.logical_and.reduce([np.isfinite(array) for array in (*now, after)])
    rows = np.flatnonzero(is_there)[: LIMITS.most_windows]
    if len(rows) < LIMITS.least_rows:
        return False
    pairs = neighbours([array[rows] for array in now], part[rows], 1)
    found = None if pairs is None else disagreement(pairs, after[rows])
    return found is not None and found.share < LIMITS.followed
