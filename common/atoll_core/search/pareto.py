"""Fronts of error against complexity, and their runners-up: total order, dominance, merging (docs/protocol.md).

With noise, the true equation is often not the best equation of its complexity, but one of the next best. Therefore
*runners-up* are kept in addition to a front: the next best entries of each complexity, distinct in function. Two
entries count as one function when both of their errors on all rows agree to four digits. Such agreement is seldom
chance; if it is, only one of two equally good equations is lost. Only numbers are compared, so that results are equal
on every machine.
"""

import math
from bisect import bisect_left, insort
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

AGREEMENT: Final = 1e-4
"""Equations count as the same function when both errors differ by at most this share of the smaller one."""

Key = tuple[int, float, int, int, int, bytes]


@dataclass(frozen=True, slots=True)
class FrontEntry:
    """One equation, measured on all rows, with the epoch, generation and island that found it.

    `error` is the loss and `mse` the mean squared error, both in the target's units; `program` holds the canonical
    bytes of `atoll_core.expression.program.Program`.
    """

    complexity: int
    error: float
    mse: float
    epoch: int
    generation: int
    island: int
    program: bytes

    @property
    def key(self) -> Key:
        """The total order in which entries are compared and kept."""
        return (self.complexity, self.error, self.epoch, self.generation, self.island, self.program)


def merge(front: Iterable[FrontEntry], additions: Iterable[FrontEntry]) -> tuple[FrontEntry, ...]:
    """Return the non-dominated entries of both, by rising complexity and falling error. Pure; order-independent."""
    kept: list[FrontEntry] = []
    for entry in sorted((*front, *additions), key=lambda candidate: candidate.key):
        if math.isfinite(entry.error) and (not kept or entry.error < kept[-1].error):
            kept.append(entry)
    return tuple(kept)


def runners_up(front: Iterable[FrontEntry], candidates: Iterable[FrontEntry], most: int) -> tuple[FrontEntry, ...]:
    """Return the `most` next best entries of each complexity that differ in function from `front`, in the total order.

    Of equations with one structure, or with equal errors, only the first in the total order stays: the simpler
    equation, or among equally simple equations the better one. Pure; independent of the order of `candidates`, which
    may hold members of the front.
    """
    members = {entry.key for entry in front}
    entries = {entry.key: entry for entry in (*front, *candidates)} if most > 0 else {}
    return tuple(_next_best((entries[key] for key in sorted(entries)), members, most))


def _next_best(ordered: Iterable[FrontEntry], members: set[Key], most: int) -> Iterator[FrontEntry]:
    structures: set[bytes] = set()
    errors: list[tuple[float, float]] = []
    complexity, count = 0, 0
    for entry in ordered:
        if entry.complexity != complexity:
            complexity, count = entry.complexity, 0
        is_member = entry.key in members
        if not is_member and (count >= most or not _is_new(entry, structures, errors)):
            continue
        structures.add(structure_of(entry.program))
        insort(errors, (entry.error, entry.mse))
        if not is_member:
            count += 1
            yield entry


def _is_new(entry: FrontEntry, structures: set[bytes], errors: list[tuple[float, float]]) -> bool:
    """Tell whether an entry has finite errors and is a new function."""
    if not math.isfinite(entry.error) or structure_of(entry.program) in structures:
        return False
    low, high = entry.error * (1.0 - AGREEMENT), entry.error * (1.0 + AGREEMENT)
    for error, mse in errors[bisect_left(errors, (low, -math.inf)) :]:
        if error > high:
            break
        if abs(mse - entry.mse) <= AGREEMENT * min(mse, entry.mse):
            return False
    return True


def structure_of(program: bytes) -> bytes:
    """Return the canonical bytes of a program (`Program.to_bytes`) without its constants."""
    return program[: 1 + 5 * program[0]] if program else program
