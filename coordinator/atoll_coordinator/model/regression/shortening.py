"""Finds the shortest description for one equation, among some candidates and programs similar to them (ADR 0012). Pure
if there is no deadline.

The symbolic search compares individuals by their error on some rows. This module compares description lengths: misfit
plus the price of the program, in nats. `Shortening.find_candidates` decides, in this order:

1. Members of the front are measured. Members that are far longer than the shortest are not changed further.
2. The others are reduced: parts are removed as long as the description gets shorter.
3. Among the programs with nearly the shortest description, the smallest program is selected, since a larger program may
   already describe noise. The neighbours of the smallest program (programs one step away) are tried.
4. Neighbours of the shortest program are tried, as long as the description gets shorter.

Steps 3 and 4 are skipped if the misfit is already at its lower limit: then only the size could improve. The caller
supplies the function that fits a program and computes its description length. This function fits to the rows of a
target, or to the steps of a process.

Doubtful: this is a local search, and each step keeps only `SETTINGS.effort.beam` programs.
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
"""Neighbours are kept if their description is at most this many nats longer than the shortest description (odds of
400). Neighbours of the smallest program within this margin are tried as well."""


@dataclass(frozen=True, eq=False)
class MeasuredProgram:
    """A fitted program, its misfit (nats), and the length of its description (nats)."""

    program: Program
    misfit: float
    length: float

    @property
    def rank(self) -> tuple[float, int, bytes]:
        """The sort key, smaller for better programs: length of the description, then size of the program."""
        return (self.length, len(self.program), self.program.to_bytes())


Measure = Callable[[Program, float], MeasuredProgram]
"""A function of a program and a length in nats. It fits and measures the program. If the description will be longer
than this length, the fit may be less precise."""


@dataclass(frozen=True, eq=False)
class Shortening:
    """Finds shorter programs similar to the members of a front. The measured programs are stored by their structure.

    When `is_over` returns True, no further program is tried. `least_misfit` is the lower limit of the misfit. Members
    that are more than `reach` nats longer than the shortest member are not reduced.
    """

    measure: Measure
    is_over: Callable[[], bool]
    neighbours: Callable[[Program], Iterable[Program]] = lambda program: ()
    least_misfit: float = -math.inf
    reach: float = math.inf
    _measured: dict[bytes, tuple[MeasuredProgram, float]] = field(default_factory=dict)

    @property
    def measured_programs(self) -> list[MeasuredProgram]:
        """All programs that were measured."""
        return [measured for measured, _ in self._measured.values()]

    def find_candidates(
        self, front: Sequence[Program], tries_neighbours: bool = True
    ) -> list[tuple[MeasuredProgram, int]]:
        """Return the members of `front` and similar programs, the shortest first. Each has the index of the member from
        which it was derived.

        If `tries_neighbours` is False, neighbours of the members are not tried.
        """
        found: dict[bytes, tuple[MeasuredProgram, int]] = {}

        def add(programs: Iterable[MeasuredProgram], member: int) -> None:
            for measured in programs:
                found.setdefault(structure(measured.program), (measured, member))

        def shortest_first() -> list[tuple[MeasuredProgram, int]]:
            return sorted(found.values(), key=lambda entry: entry[0].rank)

        members = self._measure_members(front)
        for measured, member in members:
            is_near = measured.length <= members[0][0].length + self.reach
            add((measured, self._reduce(measured)) if is_near else (measured,), member)
        if found and tries_neighbours:
            ranked = shortest_first()
            best = ranked[0]
            near = [entry for entry in ranked if entry[0].length <= best[0].length + MARGIN] or [best]
            simple = min(near, key=lambda entry: len(entry[0].program))
            if simple is not best and not self._is_exact(best[0]):
                add(self._measure_neighbours(simple[0]), simple[1])
                best = shortest_first()[0]
            while not self._is_exact(best[0]) and not self.is_over():
                add(self._measure_neighbours(best[0]), best[1])
                following = shortest_first()[0]
                if following is best:
                    break
                best = following
        return shortest_first()

    def _is_exact(self, measured: MeasuredProgram) -> bool:
        return measured.misfit <= self.least_misfit

    def _measure_members(self, front: Sequence[Program]) -> list[tuple[MeasuredProgram, int]]:
        """Return the shortest members, measured and sorted by rising length. If several have the same structure, only
        the first is returned."""
        programs = {structure(program): (index, program) for index, program in reversed([*enumerate(front)])}
        members, least = list[tuple[MeasuredProgram, int]](), math.inf
        for index, program in sorted(programs.values(), key=lambda entry: entry[0]):
            members.append((self._measure_once(program, least + self.reach), index))
            least = min(least, members[-1][0].length)
        return sorted(members, key=lambda entry: (entry[0].length, entry[1]))[: SETTINGS.effort.beam]

    def _measure_once(self, program: Program, most: float) -> MeasuredProgram:
        """Return the measured `program`; it is measured again only if its length may be below `most`."""
        key = structure(program)
        known = self._measured.get(key)
        if known is None or known[0].length > known[1] < most:
            known = self._measured[key] = self.measure(program, most), most
        return known[0]

    def _reduce(self, measured: MeasuredProgram) -> MeasuredProgram:
        """Replace the program by its reduction with the shortest description. Repeat this until no reduction has a
        shorter description."""
        while True:
            best = measured
            for program in reductions(measured.program):
                if self.is_over():
                    break
                best = min(best, self._measure_once(program, best.length), key=lambda one: one.length)
            if best is measured:
                return measured
            measured = best

    def _measure_neighbours(self, best: MeasuredProgram) -> list[MeasuredProgram]:
        """Return the shortest programs one step from `best`, and the reductions of each.

        Programs with equal misfits are equal functions: only the shortest of them is kept. Programs equal to `best` are
        an exception: for each collection of operators the shortest is kept, since its constants may be simpler.
        """
        most = best.length + MARGIN
        found: dict[tuple[str, bytes], MeasuredProgram] = {}
        for program in self.neighbours(best.program):
            if self.is_over():
                break
            measured = self._measure_once(program, most)
            meaning = (f"{measured.misfit:.4f}", b"")
            if meaning[0] == f"{best.misfit:.4f}":
                meaning = (meaning[0], np.sort(measured.program.operators).tobytes())
            if measured.length < most and (meaning not in found or measured.length < found[meaning].length):
                found[meaning] = measured
        nearest = sorted(found.values(), key=lambda one: (one.length, structure(one.program)))[: SETTINGS.effort.beam]
        return [one for neighbour in nearest for one in (neighbour, self._reduce(neighbour))]
