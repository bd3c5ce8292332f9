"""From candidates for one equation to the shortest description near them (ADR 0012). Pure without a deadline.

The search compares individuals by their error on some rows; here whole descriptions are compared. Members of the front
that are far from the shortest are left out; the others are reduced. Then the programs one step from the smallest of the
nearly shortest descriptions are tried (a larger one may have begun to describe the noise), then programs one step from
the shortest as long as the description gets shorter; not when its errors are at the limit, where only its size could be
better. How programs are fitted and measured is up to the caller: to the rows of a target, or to the steps of a process.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from atoll_coordinator.model.structure.moves.reductions import reductions
from atoll_coordinator.settings import SETTINGS
from atoll_core.expression.program import Program, structure

MARGIN: Final = 2.0 * SETTINGS.inference.distinct_nats
"""Neighbours are candidates whose description is longer than the best by at most this many nats (odds of 400), and the
neighbours of the smallest program within this limit are tried, too."""


@dataclass(frozen=True, eq=False)
class Measured:
    """A fitted program, its misfit and the length of its description, in nats."""

    program: Program
    misfit: float
    length: float

    @property
    def rank(self) -> tuple[float, int, bytes]:
        """Smaller for better programs: shorter descriptions, then smaller programs."""
        return (self.length, len(self.program), self.program.to_bytes())


Measure = Callable[[Program, float], Measured]
"""Fits and measures a program; less well if its description will be longer than this many nats."""


@dataclass(frozen=True, eq=False)
class Shortening:
    """Shortens a front. Remembers what it has measured, by structure.

    Nothing more is tried once it `is_over`. A description with the misfit `least_misfit` cannot get better. Members
    that are longer than the shortest by more than `reach` nats are not reduced.
    """

    measure: Measure
    is_over: Callable[[], bool]
    neighbours: Callable[[Program], Iterable[Program]] = lambda program: ()
    least_misfit: float = -math.inf
    reach: float = math.inf
    _measured: dict[bytes, tuple[Measured, float]] = field(default_factory=dict)

    @property
    def tried(self) -> list[Measured]:
        """All programs that were measured."""
        return [measured for measured, _ in self._measured.values()]

    def candidates(self, front: Sequence[Program], looks_around: bool = True) -> list[tuple[Measured, int]]:
        """Return the programs that `front` leads to, and the numbers of the members that they came from.

        The shortest are the first; nothing when none has a finite error. Without `looks_around`, neighbours of the
        members are not tried.
        """
        found: dict[bytes, tuple[Measured, int]] = {}

        def take_in(programs: Iterable[Measured], member: int) -> None:
            for measured in programs:
                found.setdefault(structure(measured.program), (measured, member))

        def shortest_first() -> list[tuple[Measured, int]]:
            return sorted(found.values(), key=lambda entry: entry[0].rank)

        members = self._members(front)
        for measured, member in members:
            is_near = measured.length <= members[0][0].length + self.reach
            take_in((measured, self._reduced(measured)) if is_near else (measured,), member)
        if found and looks_around:
            ranked = shortest_first()
            best = ranked[0]
            near = [entry for entry in ranked if entry[0].length <= best[0].length + MARGIN] or [best]
            simple = min(near, key=lambda entry: len(entry[0].program))
            if simple is not best and not self._is_exact(best[0]):
                take_in(self._around(simple[0]), simple[1])
                best = shortest_first()[0]
            while not self._is_exact(best[0]) and not self.is_over():
                take_in(self._around(best[0]), best[1])
                following = shortest_first()[0]
                if following is best:
                    break
                best = following
        return shortest_first()

    def _is_exact(self, measured: Measured) -> bool:
        return measured.misfit <= self.least_misfit

    def _members(self, front: Sequence[Program]) -> list[tuple[Measured, int]]:
        """Return the members worth the effort, measured, by rising length; of equal structures the first."""
        programs = {structure(program): (index, program) for index, program in reversed([*enumerate(front)])}
        members, least = list[tuple[Measured, int]](), math.inf
        for index, program in sorted(programs.values(), key=lambda entry: entry[0]):
            members.append((self._tried(program, least + self.reach), index))
            least = min(least, members[-1][0].length)
        return sorted(members, key=lambda entry: (entry[0].length, entry[1]))[: SETTINGS.effort.beam]

    def _tried(self, program: Program, most: float) -> Measured:
        """Return `program` measured, which is of interest if its length is at most `most`."""
        key = structure(program)
        known = self._measured.get(key)
        if known is None or known[0].length > known[1] < most:
            known = self._measured[key] = self.measure(program, most), most
        return known[0]

    def _reduced(self, measured: Measured) -> Measured:
        """Follow the reductions, each time the one of the shortest description, until none is shorter."""
        while True:
            best = measured
            for program in reductions(measured.program):
                if self.is_over():
                    break
                best = min(best, self._tried(program, best.length), key=lambda one: one.length)
            if best is measured:
                return measured
            measured = best

    def _around(self, best: Measured) -> list[Measured]:
        """Return the most promising programs one step from `best`, each also reduced.

        Of programs with equal errors, which are equal functions, the shortest is kept; of programs equal to `best`, the
        shortest for each collection of operators, since their constants may be simpler.
        """
        most = best.length + MARGIN
        found: dict[tuple[str, bytes], Measured] = {}
        for program in self.neighbours(best.program):
            if self.is_over():
                break
            measured = self._tried(program, most)
            meaning = (f"{measured.misfit:.4f}", b"")
            if meaning[0] == f"{best.misfit:.4f}":
                meaning = (meaning[0], np.sort(measured.program.operators).tobytes())
            if measured.length < most and (meaning not in found or measured.length < found[meaning].length):
                found[meaning] = measured
        nearest = sorted(found.values(), key=lambda one: (one.length, structure(one.program)))[: SETTINGS.effort.beam]
        return [one for neighbour in nearest for one in (neighbour, self._reduced(neighbour))]
