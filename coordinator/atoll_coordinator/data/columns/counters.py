"""Columns that count the rows: numbers of packets, samples or records. Pure."""

from collections.abc import Iterator

import numpy as np

from atoll_coordinator.data.columns.finding import Columns, Finding, Parts, listed


def check_counters(columns: Columns) -> Iterator[Finding]:
    """Yield a finding for the states that count the rows; they are not sought, unless nothing else would be."""
    states = columns.roles.states
    counters = tuple(name for name in states if columns.may_leave_out(name) and counts_rows(columns.values[name]))
    if counters and len(counters) < len(states):
        named = " and ".join(f"'{name}'" for name in counters)
        counts, them = ("counts", "it") if len(counters) == 1 else ("count", "them")
        yield Finding(
            f"{named} {counts} the rows and {'is' if them == 'it' else 'are'} no quantity of the system",
            f"no equation is sought for {them} (--states {listed(states)} keeps {them})",
            left_out=counters,
        )


def counts_rows(parts: Parts) -> bool:
    """Say whether a column has whole numbers that rise by one from each row to the next, along all trajectories."""
    is_whole = all(bool(np.all(part == np.floor(part))) for part in parts)
    return is_whole and all(bool(np.all(np.diff(part) == 1.0)) for part in parts)
