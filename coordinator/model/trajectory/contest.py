"""Which equations together describe the measured states in the fewest nats (Rissanen 1978), trajectories simulated.

By derivative error a wrong equation often beats the true one, because smoothing errors are large and coloured; by the
misfit of simulated trajectories to the raw states hardly ever.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np

from common.dataset import FloatArray
from common.expression.program import Program
from coordinator.model.rewrite import structure
from coordinator.model.trajectory.plausibility import structure_nats
from coordinator.model.trajectory.shooting import Shooter, Shot, misfit, staged
from coordinator.model.trajectory.system import split, system_of

EXACT: Final = 1e-8
"""Errors below this share of a state's standard deviation are those of the integration, not of the model."""

_RIDGE: Final = 1e-14
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Standing:
    """A system fitted to whole trajectories: its `programs` with fitted constants, the fit, its nats."""

    programs: tuple[Program, ...]
    shot: Shot
    misfit: float
    nats: float


class Contest:
    """Fits and compares systems over the same measurements; `names` are the variables of the programs."""

    def __init__(self, shooter: Shooter, names: Sequence[str], threads: int = 1) -> None:
        self.shooter: Final = shooter
        self.names: Final = tuple(names)
        its = shooter.measurements
        self.floors: Final = EXACT * its.scales[its.observed]
        self.constant_nats: Final = 0.5 * math.log(its.rows)
        """What a fitted constant costs (Schwarz 1978)."""
        self._pool = ThreadPoolExecutor(threads)
        self._known: dict[tuple[bytes, ...], Standing | None] = {}

    def key(self, programs: Sequence[Program]) -> tuple[bytes, ...]:
        """Return what tells systems apart that differ in more than fitted constants."""
        return tuple(structure(program) for program in programs)

    def map(self, work: Callable[[T], Standing | None], items: Iterable[T]) -> list[Standing]:
        """Return what `work` makes of the items, the shortest description first; without those that failed."""
        done = [its for its in self._pool.map(work, items) if its is not None and math.isfinite(its.nats)]
        return sorted(done, key=lambda its: its.nats)

    def stand(self, programs: Sequence[Program], steps: int = 20,
              lengths: Sequence[int | None] = (8, 25, None)) -> Standing | None:  # fmt: skip
        """Return the fitted system of `programs`, None when it cannot be simulated."""
        its = self.shooter.measurements
        shot = staged(self.shooter, system_of(programs, self.names, its.names), lengths, steps)
        return None if shot is None else self.measured(split(shot.system, programs), shot)

    def beside(self, near: Standing, programs: Sequence[Program], steps: int = 20) -> Standing | None:
        """Return the fitted system of `programs`, begun with the initial states of `near`."""
        its = self.shooter.measurements
        system = system_of(programs, self.names, its.names)
        shot = self.shooter.fit(system, None, steps, near.shot.starts, near.shot.sigmas)
        return None if shot is None else self.measured(split(shot.system, programs), shot)

    def exchanged(self, near: Standing, equation: int, program: Program, steps: int) -> Standing | None:
        """Return `near` with another program for one equation."""
        return self.beside(near, [*near.programs[:equation], program, *near.programs[equation + 1 :]], steps)

    def halved(self, near: Standing, equation: int, programs: Iterable[Program], rounds: Sequence[tuple[int, int]]) -> list[Standing]:
        """Return standings of the best of `programs` for one equation; fewer of them after each of the rounds.

        Each of `rounds` is a number of steps and how many stay.
        """
        found: list[Standing] = []
        waiting = list(programs)
        for steps, kept in rounds:
            found = self.map(lambda program, steps=steps: self.exchanged(near, equation, program, steps), waiting)[:kept]
            waiting = [its.programs[equation] for its in found]
        return found

    def measured(self, programs: Sequence[Program], shot: Shot) -> Standing:
        """Return the standing of a fit."""
        its = misfit(shot, self.floors, self.shooter.weights)
        nats = its + sum(map(structure_nats, programs)) + self.constant_nats * len(shot.system.places)
        return Standing(tuple(programs), shot, its, nats)


def covariance(shot: Shot) -> FloatArray:
    """Return the covariance (P, P) of the fitted constants, initial states eliminated."""
    reduced = shot.reduced
    scale = np.sqrt(np.clip(np.diag(reduced), 1e-100, 1e100))
    with np.errstate(all="ignore"):
        unit = np.nan_to_num(reduced / np.outer(scale, scale), posinf=0.0, neginf=0.0) + _RIDGE * np.eye(len(scale))
    try:
        return np.asarray(np.linalg.pinv(unit, hermitian=True) / np.outer(scale, scale))
    except np.linalg.LinAlgError:
        return np.full_like(reduced, math.inf)
