"""An island: one population and all that coevolves with it. Its epoch is a pure function.

(state at epoch e, problem, configuration, seed) -> (state after the generations, additions to the front, counters).
No clock, no I/O, no global random state, no thread order in it: one seed, one answer.
"""

import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Self

import numpy as np

from atoll_core.config import JobConfig
from atoll_core.data.dataset import AnyArray, Problem
from atoll_core.errors import LocalProtocolError, RemoteProtocolError
from atoll_core.search.pareto import FrontEntry
from atoll_core.search.seeding import stream_key
from atoll_core.wire.codec import decode_arrays, encode_arrays
from atoll_core.wire.messages.epochs import Addition, HitStatement, IslandReport, SliceCounters
from atoll_island_worker.evolution import migration
from atoll_island_worker.evolution.coevolution import begin_coevolution, evolve, measure_population
from atoll_island_worker.evolution.front import Front, FrontUpdater
from atoll_island_worker.evolution.guesses import begin_with_guesses
from atoll_island_worker.evolution.kernels.generation import OFFSPRING, PARTS, REEVALUATION, random_population
from atoll_island_worker.evolution.kernels.trainers import train
from atoll_island_worker.evolution.runners_up import RunnersUp
from atoll_island_worker.evolution.setup import IslandSetup
from atoll_island_worker.evolution.structures import Lists, empty_lists

LOOKS_BESIDE = 5
"""Slices from one look at the next best of each size to the next; the last one of an epoch looks as well."""


class Island:
    """One island of one variable between epochs. Mutable, but only through `advance` and `immigrate`, in turn.

    The life of an island: ``Island(...)`` (epoch 0, random population), then for every epoch: `advance` until it
    returns True or no more is needed, `report`, and, unless the archipelago ended, `emigrants` to send and `immigrate`
    with all that is due here (own ones included), which begins the next epoch. `generation` counts the generations of
    the current epoch that have passed.

    Raises:
        LocalProtocolError: a field of `config` that must be resolved is not, or a method is called out of turn.
    """

    def __init__(self, problem: Problem, config: JobConfig, island: int) -> None:
        self._setup = IslandSetup(problem, config, island)
        self._lists = empty_lists(config.evolution.population, self._setup.space.nodes)
        self._fitness = np.full(config.evolution.population, math.inf)
        self._coevolution = self._setup.empty_coevolution()
        self._counters = np.zeros(len(PARTS), np.int64)
        self._front = Front()
        self._runners_up = RunnersUp(self._setup.runners_up)
        self._updater = FrontUpdater(self._setup, self._front, self._runners_up)
        self.epoch = 0
        self._start_epoch()

    def _start_epoch(self) -> None:
        self.generation = 0
        self._hit: HitStatement | None = None
        self._begun = False
        self._additions: list[FrontEntry] = []
        self._near: list[FrontEntry] = []
        self._counters_by_slice: list[SliceCounters] = []
        self._updater.begin_epoch()
        setup = self._setup
        key = stream_key(setup.config.seed, setup.variable, setup.island, self.epoch, "generations")
        self._stream = np.array([key], np.uint64)

    def advance(self, generations: int = 10) -> bool:
        """Advance at most `generations` generations; return True when the epoch is finished or the target was hit."""
        if not self._begun:
            self._begin()
        interval, last = self._setup.config.evolution.refit_interval, self._setup.config.migration.generations
        end = min(last, self.generation + generations)
        while self.generation < end and self._hit is None:
            step = min(end - self.generation, interval - self.generation % interval)
            evolve(self._setup, step, self._lists, self._fitness, self._coevolution, self._stream, self._counters)
            self.generation += step
            if self.generation % interval == 0 or self.generation == last:
                self._offer()
                evaluations: dict[str, int] = dict(zip(PARTS, self._counters.tolist(), strict=True))
                self._counters_by_slice.append(SliceCounters(generation=self.generation, evaluations=evaluations))
        return self._hit is not None or self.generation == last

    def _begin(self) -> None:
        """Draw the first population and its predictors at epoch 0; measure what immigrated later on."""
        setup, part = self._setup, OFFSPRING if self.epoch == 0 else REEVALUATION
        if self.epoch == 0:
            random_population(self._lists, setup.space, self._stream)
            begin_with_guesses(self._lists, setup, self._updater.sample, self._counters)
            if setup.coevolving.enabled:
                begin_coevolution(setup, self._lists, self._coevolution, self._stream, self._counters)
        measure_population(setup, self._lists, self._fitness, self._coevolution, self._counters, part)
        self._begun = True

    def _offer(self) -> None:
        config = self._setup.config
        every, last = LOOKS_BESIDE * config.evolution.refit_interval, config.migration.generations
        looks_beside = self.generation % every == 0 or self.generation == last
        additions, near = self._updater.offer(self._lists, self._fitness, self._counters, self._tag(), looks_beside)
        self._additions += additions
        self._near += near
        least = self._front.least_error()
        target = self._setup.target
        if least is not None and least <= target:
            self._additions += self._updater.prune(target, self._counters, self._tag())
            self._hit = HitStatement(generation=self.generation, error=self._normalized(self._front.least_error()))

    def _tag(self) -> tuple[int, int, int]:
        return (self.epoch, self.generation, self._setup.island)

    def _normalized(self, error: float | None) -> float:
        return math.inf if error is None else error / self._setup.deviation

    @property
    def spent(self) -> int:
        """Point evaluations since epoch 0, of all parts."""
        return sum(self._counters.tolist())

    def additions(self, first: int = 0) -> tuple[FrontEntry, ...]:
        """Return what improved the island's front in this epoch, from entry number `first` on."""
        return tuple(self._setup.outward(entry) for entry in self._additions[first:])

    def report(self) -> IslandReport:
        """Return what is reported of the epoch, finished or not: as far as it has come."""
        best = self._normalized(self._front.least_error())
        digest = hashlib.blake2b(digest_size=16)
        for array in self._state_arrays().values():
            digest.update(np.ascontiguousarray(array).tobytes())
        return IslandReport(
            island=self._setup.island,
            generations=self.generation,
            hit=self._hit,
            additions=_stated(self.additions()),
            runners_up=_stated(self._setup.outward(entry) for entry in self._near),
            counters=tuple(self._counters_by_slice),
            best_error=best if math.isfinite(best) else None,
            digest=digest.hexdigest(),
        )

    def emigrants(self) -> dict[int, bytes]:
        """Return, by destination island (this one included), a block of solutions with their destination slots."""
        setup = self._setup
        places = migration.destinations(setup.config, setup.variable, self.epoch)[setup.island]
        return migration.pack(self._lists, places)

    def senders(self) -> frozenset[int]:
        """Return the other islands whose solutions the reshuffle of this epoch sends here."""
        setup = self._setup
        return migration.senders(setup.config, setup.variable, self.epoch, setup.island)

    def immigrate(self, blocks: Mapping[int, bytes]) -> None:
        """Rebuild the population by slot from the blocks of exactly `senders()` and of this island, keyed by source.

        Raises RemoteProtocolError when a block is malformed or the slots do not add up; the island is then unchanged.
        """
        if not self._begun:
            raise LocalProtocolError(f"island {self._setup.island} cannot take immigrants before its epoch has run")
        self._go_on_with(migration.unpack(blocks, len(self._fitness), self._setup.space, self._setup.allowed))

    def _go_on_with(self, lists: Lists) -> None:
        for mine, theirs in zip(self._lists._asdict().values(), lists, strict=True):
            mine[...] = theirs
        self.epoch += 1
        self._start_epoch()

    def _state_arrays(self) -> dict[str, AnyArray]:
        coevolution = self._coevolution
        arrays: dict[str, AnyArray] = {f"list {name}": array for name, array in self._lists._asdict().items()}
        arrays |= {f"trainer {name}": array for name, array in coevolution.trainers._asdict().items()}
        arrays |= {
            name: getattr(coevolution, name) for name in ("predictors", "quality", "exact", "born", "best", "clock")
        }
        return arrays | {
            "fitness": self._fitness,
            "counters": self._counters,
            "offered": self._updater.offered,
            "offered loss": self._updater.offered_loss,
            "known": self._runners_up.known,
        }

    def to_bytes(self) -> bytes:
        """Return everything that can influence later bits or counters, between epochs: a checkpoint is made of it."""
        if self._begun:
            raise LocalProtocolError("an island is written between epochs only, before generation 0")
        arrays = {k: a.astype(np.int32) if a.dtype == np.int16 else a for k, a in self._state_arrays().items()}
        front, near = _listed(self._front.entries), _listed(self._runners_up.entries)
        return encode_arrays({"epoch": self.epoch, "front": front, "runners up": near}, arrays)

    @classmethod
    def from_bytes(cls, data: bytes, problem: Problem, config: JobConfig, island: int) -> Self:
        """Rebuild an island from `to_bytes`; raises RemoteProtocolError."""
        header, arrays = decode_arrays(data)
        restored = cls(problem, config, island)
        try:
            for name, mine in restored._state_arrays().items():
                if (arrays[name].shape, arrays[name].dtype.kind) != (mine.shape, mine.dtype.kind):
                    raise ValueError(f"{name} has shape {arrays[name].shape}, expected {mine.shape}")
                mine[...] = arrays[name]
            restored.epoch = int(header["epoch"])
            restored._front.replace(FrontEntry(*entry) for entry in header["front"])
            restored._runners_up.replace(FrontEntry(*entry) for entry in header["runners up"])
        except (KeyError, ValueError, TypeError) as error:
            raise RemoteProtocolError(f"the state of an island does not fit its job: {error}") from error
        restored._check()
        restored._retrain()
        restored._start_epoch()
        return restored

    def _check(self) -> None:
        """Raise RemoteProtocolError unless all nodes and rows that kernels will follow exist; at epoch 0 none are."""
        setup, coevolution = self._setup, self._coevolution
        if self.epoch == 0:
            return
        migration.check_nodes(self._lists, setup.space, setup.allowed)
        if not setup.coevolving.enabled:
            return
        migration.check_nodes(coevolution.trainers, setup.space, setup.allowed)
        rows_exist = ((coevolution.predictors >= 0) & (coevolution.predictors < setup.every.length)).all()
        if not (rows_exist and 0 <= coevolution.best[0] < len(coevolution.quality)):
            raise RemoteProtocolError("the predictors in the state of an island name rows that do not exist")

    def _retrain(self) -> None:
        """Bring back the trainers' losses by row, which follow from the trainers; not counted again."""
        setup = self._setup
        if setup.coevolving.enabled and self.epoch > 0:
            for t in range(self._coevolution.exact.shape[0]):
                uncounted = np.zeros(len(PARTS), np.int64)
                train(self._coevolution, t, setup.every, setup.fit, setup.scratch.tape, setup.scratch.work, uncounted)


def reshuffle(islands: Sequence[Island]) -> None:
    """Begin the next epoch of all islands of one variable, which are in this process: no blocks are written and read.

    The same solutions come to the same places as by `Island.emigrants` and `Island.immigrate`.
    """
    setup = islands[0]._setup
    places = migration.destinations(setup.config, setup.variable, islands[0].epoch)
    moved = migration.exchange([island._lists for island in islands], places)
    for island, lists in zip(islands, moved, strict=True):
        island._go_on_with(lists)


def _stated(entries: Iterable[FrontEntry]) -> tuple[Addition, ...]:
    return tuple(Addition.model_validate(entry, from_attributes=True) for entry in entries)


def _listed(entries: Iterable[FrontEntry]) -> list[list[object]]:
    return [[e.complexity, e.error, e.mse, e.epoch, e.generation, e.island, e.program] for e in entries]
