"""An island: one population with its predictors and trainers. Its epoch is a pure function.

(state at epoch e, problem, configuration, seed) -> (state after the generations, additions to the front, counters).
There is no clock, I/O, global random state or thread order in it, so the same seed gives the same bits.

Prior knowledge enters as guesses: each becomes one individual of every island of the first population. The constants of
a guess are starting values: the first island begins with them, the other islands with values around them. So an
archipelago makes as many attempts to fit a guess as it has islands (ADR 0019). Solutions, predictors and trainers
evolve in turn (Schmidt & Lipson, section 2.3 and Table II of the 2008 paper). Kernels advance many generations at once,
and stop when a trainer is renewed or the population is measured on other rows.
"""

import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, Self

import numpy as np

from atoll_core.config import JobConfig
from atoll_core.data.dataset import AnyArray, Problem
from atoll_core.errors import LocalProtocolError, RemoteProtocolError
from atoll_core.expression.kernels.tape import functions_address
from atoll_core.expression.operation_list import PlacedNode, placed_text
from atoll_core.expression.operators import ARITY, CONSTANT
from atoll_core.search.pareto import FrontEntry
from atoll_core.search.seeding import Stream, stream_key
from atoll_core.wire.codec import decode_arrays, encode_arrays
from atoll_core.wire.messages.epochs import Addition, HitStatement, IslandReport, SliceCounters
from atoll_island_worker.evolution import migration
from atoll_island_worker.evolution.front import Front, FrontUpdater, RunnersUp
from atoll_island_worker.evolution.kernels.generation import (
    OFFSPRING,
    PARTS,
    REEVALUATION,
    advance,
    draw_coevolution,
    measure_all,
    random_population,
)
from atoll_island_worker.evolution.kernels.measured_rows import gather
from atoll_island_worker.evolution.kernels.predictors import judge_all
from atoll_island_worker.evolution.kernels.random import Stream as StreamState
from atoll_island_worker.evolution.kernels.trainers import most_disputed, train
from atoll_island_worker.evolution.setup import IslandSetup
from atoll_island_worker.evolution.structures import Coevolution, Floats, Ints, Lists, empty_lists

GUESS_STEPS: Final = 25
"""Largest number of Levenberg-Marquardt steps that fit the constants of a guess before the first generation."""

OCTAVES: Final = 3
"""A varied constant is at least 2^-OCTAVES and less than 2^OCTAVES times the original constant."""

Guess = Sequence[PlacedNode]


def begin_with_guesses(lists: Lists, setup: IslandSetup, counters: Ints) -> None:
    """Write the guesses for this equation over the first individuals, one each, and fit their constants.

    They are fitted to rows spread evenly over all rows. The fit is counted as fitting of offspring. If constants are
    not fitted, all islands take the guesses unchanged. Pure except for `lists`, scratch and `counters`.
    """
    guesses = parse_guesses(setup)
    if not guesses:
        return
    is_fitted = setup.fit.steps > 0
    key = stream_key(setup.config.seed, setup.variable, setup.island, 0, "guesses")
    stream = Stream(key) if is_fitted and setup.island > 0 else None
    for p, guess in enumerate(guesses):
        place(lists, p, guess, stream)
    if is_fitted:
        first = Lists(*(column[: len(guesses)] for column in lists._asdict().values()))
        fitness, options, scratch = np.zeros(len(guesses)), setup.fit._replace(steps=GUESS_STEPS), setup.scratch
        rows = setup.equation.spread
        measure_all(first, fitness, rows, options, scratch._replace(near=scratch.work), counters, OFFSPRING)


def parse_guesses(setup: IslandSetup) -> tuple[Guess, ...]:
    """Return the nodes of the guesses for the equation of `setup`.

    Raises:
        UsageError: a guess does not fit its lists; a coordinator refuses such jobs.
    """
    space = setup.space
    operators, inner = space.operators.tolist(), space.nodes - space.terminals
    texts = setup.config.prior.guesses.get(setup.variable, ())
    return tuple(placed_text(text, setup.names, operators, space.terminals, inner) for text in texts)


def place(lists: Lists, p: int, guess: Guess, stream: Stream | None) -> None:
    """Write a guess over individual `p`; constants are varied with `stream`, if there is one.

    Nodes that the guess does not use, and second arguments of unary operators, stay as they are.
    """
    for node in guess:
        lists.code[p, node.index] = node.code
        lists.left[p, node.index] = node.left
        lists.constants[p, node.index] = node.constant
        if ARITY[node.code] != 1:
            lists.right[p, node.index] = node.right
        if stream is not None and node.code == CONSTANT:
            octave = stream.below(2 * OCTAVES) - OCTAVES
            factor = math.ldexp(1.0 + stream.uniform(), octave)  # nearly log-uniform, without a logarithm
            lists.constants[p, node.index] = node.constant * factor


def begin_coevolution(
    setup: IslandSetup, lists: Lists, coevolution: Coevolution, stream: StreamState, counters: Ints
) -> None:
    """Draw random predictors and take random individuals as trainers."""
    draw_coevolution(lists, coevolution, setup.every.length, stream)
    for t in range(len(coevolution.exact)):
        setup.call(train, coevolution, t, setup.every, setup.fit, setup.scratch.tape, setup.scratch.work, counters)
    setup.call(judge_all, coevolution, setup.coevolving.relative)


def measure_population(
    setup: IslandSetup, lists: Lists, fitness: Floats, coevolution: Coevolution, counters: Ints, part: np.int64
) -> None:
    """Gather the best predictor's rows (all rows while predictors are off) and measure the population on them."""
    if setup.coevolving.enabled:
        best = coevolution.predictors[coevolution.best[0]]
        setup.call(gather, setup.rows, setup.every, best, functions_address())
    setup.call(measure_all, lists, fitness, setup.rows, setup.fit, setup.scratch, counters, part)


def renew_trainer(setup: IslandSetup, lists: Lists, coevolution: Coevolution, counters: Ints) -> bool:
    """Replace the oldest trainer by the most disputed individual; return True if the measuring rows changed."""
    relative, scratch = setup.coevolving.relative, setup.scratch
    disputed = int(
        setup.call(
            most_disputed, lists, coevolution, setup.every, scratch.spare, setup.fit, relative, scratch, counters
        )
    )
    if disputed < 0:
        return False
    oldest = int(np.argmin(coevolution.born))
    individuals = lists._asdict().values()
    for column, values in zip(coevolution.trainers._asdict().values(), individuals, strict=True):
        column[oldest] = values[disputed]
    coevolution.born[oldest] = coevolution.clock[0]
    setup.call(train, coevolution, oldest, setup.every, setup.fit, scratch.tape, scratch.work, counters)
    return bool(setup.call(judge_all, coevolution, relative))


def evolve(
    setup: IslandSetup, generations: int, lists: Lists, fitness: Floats, coevolution: Coevolution, stream: StreamState,
    counters: Ints,
) -> None:  # fmt: skip
    """Advance the island by `generations`, predictors and trainers included.

    Predictors advance only while their counted share of all point evaluations is under `coevolving.effort`.
    """
    done = 0
    while done < generations:
        done += int(
            setup.call(
                advance, generations - done, lists, fitness, coevolution, setup.space, setup.fit, setup.coevolving,
                setup.every.length, setup.rows, setup.scratch, stream, counters,
            )
        )  # fmt: skip
        renews, changed = coevolution.due.tolist()
        if renews:
            changed = renew_trainer(setup, lists, coevolution, counters) or changed
        if changed:
            measure_population(setup, lists, fitness, coevolution, counters, REEVALUATION)


NEXT_BEST_INTERVAL = 5
"""The next best of each size are offered every this many slices, and in the last slice of an epoch."""


class Island:
    """One island of one variable. Mutable, but only through `advance` and `immigrate`, in turn.

    The order of calls: ``Island(...)`` (epoch 0, random population); then for every epoch `advance`, until it returns
    True or no further generation is needed, and `report`. Unless the archipelago has ended, `emigrants` returns the
    blocks to be sent, and `immigrate` takes the blocks of all senders and of this island and begins the next epoch.
    `generation` is the number of generations done in the current epoch.

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
        """At epoch 0 draw the first population and its predictors; in later epochs measure the immigrants."""
        setup, part = self._setup, OFFSPRING if self.epoch == 0 else REEVALUATION
        if self.epoch == 0:
            random_population(self._lists, setup.space, self._stream)
            begin_with_guesses(self._lists, setup, self._counters)
            if setup.coevolving.enabled:
                begin_coevolution(setup, self._lists, self._coevolution, self._stream, self._counters)
        measure_population(setup, self._lists, self._fitness, self._coevolution, self._counters, part)
        self._begun = True

    def _offer(self) -> None:
        config = self._setup.config
        every, last = NEXT_BEST_INTERVAL * config.evolution.refit_interval, config.migration.generations
        offers_next_best = self.generation % every == 0 or self.generation == last
        additions, near = self._updater.offer(self._lists, self._fitness, self._counters, self._tag(), offers_next_best)
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
        """Return the additions to the island's front in this epoch, from entry number `first` on."""
        return tuple(self._setup.outward(entry) for entry in self._additions[first:])

    def report(self) -> IslandReport:
        """Return the report of the epoch, finished or not."""
        best = self._normalized(self._front.least_error())
        digest = hashlib.blake2b(digest_size=16)
        for array in self._state_arrays().values():
            digest.update(np.ascontiguousarray(array).tobytes())
        return IslandReport(
            island=self._setup.island,
            generations=self.generation,
            hit=self._hit,
            additions=_additions_of(self.additions()),
            runners_up=_additions_of(self._setup.outward(entry) for entry in self._near),
            counters=tuple(self._counters_by_slice),
            best_error=best if math.isfinite(best) else None,
            digest=digest.hexdigest(),
        )

    def emigrants(self) -> dict[int, bytes]:
        """Return a block of solutions, with destination slots, for each destination island including this one."""
        setup = self._setup
        places = migration.destinations(setup.config, setup.variable, self.epoch)[setup.island]
        return migration.pack(self._lists, places)

    def senders(self) -> frozenset[int]:
        """Return the other islands whose solutions the reshuffle of this epoch sends here."""
        setup = self._setup
        return migration.senders(setup.config, setup.variable, self.epoch, setup.island)

    def immigrate(self, blocks: Mapping[int, bytes]) -> None:
        """Rebuild the population by slot from the blocks of exactly `senders()` and of this island, keyed by source.

        Raises RemoteProtocolError if a block is malformed or a slot is missing or occurs twice; the island is then
        unchanged.
        """
        if not self._begun:
            raise LocalProtocolError(f"island {self._setup.island} cannot take immigrants before its epoch has run")
        self._take_population(migration.unpack(blocks, len(self._fitness), self._setup.space, self._setup.allowed))

    def _take_population(self, lists: Lists) -> None:
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
        """Return the state between two epochs: all data that can influence later bits or counters.

        It is written before generation 0, for checkpoints, or after a whole epoch, before the island takes its
        immigrants; then another process can continue with `from_bytes` and `immigrate`.
        """
        is_over = self._begun and self._hit is None and self.generation == self._setup.config.migration.generations
        if self._begun and not is_over:
            raise LocalProtocolError("an island is written between epochs only: before generation 0, or at the end")
        arrays = {k: a.astype(np.int32) if a.dtype == np.int16 else a for k, a in self._state_arrays().items()}
        front, near = _rows_of(self._front.entries), _rows_of(self._runners_up.entries)
        header = {"epoch": self.epoch, "front": front, "runners up": near}
        return encode_arrays(header | {"is over": True} if is_over else header, arrays)

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
            restored.epoch, is_over = int(header["epoch"]), header.get("is over", False) is True
            restored._front.replace(FrontEntry(*entry) for entry in header["front"])
            restored._runners_up.replace(FrontEntry(*entry) for entry in header["runners up"])
        except (KeyError, ValueError, TypeError) as error:
            raise RemoteProtocolError(f"the state of an island does not fit its job: {error}") from error
        if restored.epoch > 0 or is_over:  # before the first generation there is no population yet
            restored._check()
            restored._retrain()
        restored._start_epoch()
        if is_over:
            restored._begun, restored.generation = True, config.migration.generations
        return restored

    def _check(self) -> None:
        """Raise RemoteProtocolError unless all nodes and rows that kernels will use exist."""
        setup, coevolution = self._setup, self._coevolution
        migration.check_nodes(self._lists, setup.space, setup.allowed)
        if not setup.coevolving.enabled:
            return
        migration.check_nodes(coevolution.trainers, setup.space, setup.allowed)
        rows_exist = ((coevolution.predictors >= 0) & (coevolution.predictors < setup.every.length)).all()
        if not (rows_exist and 0 <= coevolution.best[0] < len(coevolution.quality)):
            raise RemoteProtocolError("the predictors in the state of an island name rows that do not exist")

    def _retrain(self) -> None:
        """Compute the trainers' losses at all rows again, which checkpoints lack; these evaluations are not counted."""
        setup = self._setup
        if setup.coevolving.enabled:
            for t in range(self._coevolution.exact.shape[0]):
                uncounted = np.zeros(len(PARTS), np.int64)
                setup.call(
                    train, self._coevolution, t, setup.every, setup.fit, setup.scratch.tape, setup.scratch.work,
                    uncounted,
                )  # fmt: skip


def reshuffle_without_blocks(islands: Sequence[Island]) -> None:
    """Begin the next epoch of all islands of one variable, for benchmarks that have them in one process.

    The same solutions go to the same places as with `Island.emigrants` and `Island.immigrate`, whose blocks take twenty
    times as long.
    """
    setup = islands[0]._setup
    places = migration.destinations(setup.config, setup.variable, islands[0].epoch)
    moved = migration.exchange_without_blocks([island._lists for island in islands], places)
    for island, lists in zip(islands, moved, strict=True):
        island._take_population(lists)


def _additions_of(entries: Iterable[FrontEntry]) -> tuple[Addition, ...]:
    return tuple(Addition.model_validate(entry, from_attributes=True) for entry in entries)


def _rows_of(entries: Iterable[FrontEntry]) -> list[list[object]]:
    return [[e.complexity, e.error, e.mse, e.epoch, e.generation, e.island, e.program] for e in entries]
