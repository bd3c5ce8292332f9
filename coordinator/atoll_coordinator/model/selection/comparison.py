"""Which equations together describe the measured states in the fewest nats (Rissanen 1978), trajectories simulated.

By derivative error a wrong equation often beats the true one, because smoothing errors are large and coloured; by the
misfit of simulated trajectories to the raw states hardly ever.
"""

import math
from bisect import bisect_left, bisect_right, insort
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np

from atoll.expression.program import Program, constant_places, structure
from atoll_coordinator.model.criteria import constant_nats_of, system_length, trajectory_misfit
from atoll_coordinator.model.settings import SETTINGS
from atoll_coordinator.model.shooting.multiple_shooting import Shooter, Shot, staged
from atoll_coordinator.model.shooting.system import System, split, system_of

Item = TypeVar("Item")


@dataclass(frozen=True, eq=False)
class Standing:
    """A system fitted to trajectories: its `programs` with fitted constants, the fit, and its nats.

    `nats` are those of the misfit, of the programs, and 1/2 ln N for each fitted constant (Schwarz 1978).
    """

    programs: tuple[Program, ...]
    shot: Shot
    misfit: float
    nats: float


class Contest:
    """Fits and compares systems over the same measurements.

    `names` are the variables of the programs, `fixed` the equations (by index) whose constants are given; with order 2
    `leading` are the equations of the positions, which come before those that are sought and are not counted. `tried`
    has the best standing of each program that was ever fitted for an equation, by (equation, structure). Systems are
    fitted by the threads of `executor`, whose owner shuts it down; one after another without one.
    """

    def __init__(
        self, shooter: Shooter, names: Sequence[str], fixed: Iterable[int] = (), leading: Sequence[Program] = (),
        executor: Executor | None = None,
    ) -> None:  # fmt: skip
        its = shooter.measurements
        self.shooter: Final = shooter
        self.names: Final = tuple(names)
        self.fixed: Final = frozenset(fixed)
        self.leading: Final = tuple(leading)
        self.tried: Final[dict[tuple[int, bytes], Standing]] = {}
        self.counts: Final = its.weights.sum(axis=1)
        self.floors: Final = SETTINGS.selection.exact * its.scales[its.observed]
        self.coherence: Final = its.coherence
        self.constant_nats: Final = constant_nats_of(its.rows / its.coherence)
        self._map: Final = map if executor is None else executor.map

    def map(self, work: Callable[[Item], Standing | None], items: Iterable[Item]) -> list[Standing]:
        """Return what `work` makes of the items, the shortest description first; without those that failed."""
        done = [its for its in self._map(work, items) if its is not None and math.isfinite(its.nats)]
        return sorted(done, key=lambda its: its.nats)

    def _bounded(self, work: Callable[[Item], Standing | None], items: Sequence[Item], until: float) -> list[Standing]:
        """Return what `map` does, of the first items as far as the shooter's work is less than `until`."""
        found: list[Standing] = []
        for first in range(0, len(items), SETTINGS.selection.batch):
            if first and self.shooter.work >= until:
                break
            found += self.map(work, items[first : first + SETTINGS.selection.batch])
        return sorted(found, key=lambda its: its.nats)

    def system(self, programs: Sequence[Program], held: Sequence[Iterable[int]] = ()) -> System:
        """Return the system of `programs`; `held` are nodes of each whose constants stay as they are."""
        fixed = [
            set(constant_places(program)) if index in self.fixed else set(held[index]) if held else set()
            for index, program in enumerate(programs)
        ]
        none: list[set[int]] = [set() for _ in self.leading]
        variables = self.shooter.measurements.variables
        return system_of([*self.leading, *programs], self.names, variables, [*none, *fixed])

    def stand(
        self,
        programs: Sequence[Program],
        steps: int = 20,
        lengths: Sequence[int | None] = SETTINGS.selection.first_lengths,
    ) -> Standing | None:
        """Return the fitted system of `programs`, None when it cannot be simulated."""
        shot = staged(self.shooter, self.system(programs), lengths, steps)
        return None if shot is None else self.measured(programs, shot)

    def beside(self, near: Standing, programs: Sequence[Program], steps: int = 20) -> Standing | None:
        """Return the fitted system of `programs`, begun with the initial states of `near`."""
        its = near.shot
        shot = self.shooter.fit(self.system(programs), None, steps, its.starts, its.sigmas, is_stiff=its.is_stiff)
        return None if shot is None else self.measured(programs, shot)

    def exchanged(self, near: Standing, equation: int, program: Program, steps: int) -> Standing | None:
        """Return `near` with another program for one equation."""
        return self.beside(near, [*near.programs[:equation], program, *near.programs[equation + 1 :]], steps)

    def halved(
        self, near: Standing, equation: int, programs: Iterable[Program], rounds: Sequence[tuple[int, int]],
        until: float = math.inf,
    ) -> list[Standing]:  # fmt: skip
        """Return standings of the best of `programs` for one equation, fewer of them after each of the `rounds`.

        Each round is a number of steps and how many programs stay. Of programs with the same misfit, which say the same
        in other words, the one of shortest description stays. Once the shooter's work is `until`, no more are taken
        in than the next few.
        """
        found: list[Standing] = []
        waiting = list(programs)
        for steps, kept in rounds:

            def fitted(program: Program, steps: int = steps) -> Standing | None:
                return self.exchanged(near, equation, program, steps)

            found = distinct(self._bounded(fitted, waiting, until))[:kept]
            waiting = [its.programs[equation] for its in found]
        for its in found:
            self._note(equation, its)
        return found

    def measured(self, programs: Sequence[Program], shot: Shot) -> Standing:
        """Return the standing of a fit of `programs`."""
        its = trajectory_misfit(shot.squares, self.floors, self.counts / self.coherence)
        nats = system_length(its, programs, len(shot.system.places), self.constant_nats)
        fitted = split(shot.system, [*self.leading, *programs])[len(self.leading) :]
        return Standing(tuple(fitted), shot, its, nats)

    def is_exact(self, standing: Standing) -> bool:
        """Tell whether all errors are those of the integration."""
        return bool(np.all(standing.shot.squares <= self.floors * self.floors))

    def _note(self, equation: int, standing: Standing) -> None:
        key = (equation, structure(standing.programs[equation]))
        known = self.tried.get(key)
        if known is None or standing.nats < known.nats:
            self.tried[key] = standing


def distinct(standings: Iterable[Standing]) -> list[Standing]:
    """Return the standings, sorted by nats, without those whose misfit is that of one before."""
    kept: list[Standing] = []
    misfits: list[float] = []
    for each in standings:
        its = each.misfit
        reach = 2.0 * SETTINGS.selection.repeated * (1.0 + abs(its))  # no other one can be near enough
        near = misfits[bisect_left(misfits, its - reach) : bisect_right(misfits, its + reach)]
        if all(abs(its - other) > SETTINGS.selection.repeated * (1.0 + abs(other)) for other in near):
            kept.append(each)
            insort(misfits, its)
    return kept
