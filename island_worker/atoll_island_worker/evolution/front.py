"""An island's front: the equations with the least error on all rows for each complexity, and how they are found.

Only individuals that were measured on all rows enter. The best individual of each size is refitted on all rows. Its
linear scaling can be written into the program in several ways (with or without the shift, coefficients near 1 exact or
not); each way that improves the front is an addition. The path of an individual: list -> `FrontUpdater.offer` (refit in
kernels, into a `Book`) -> canonical tape with its coefficients, measured again in kernels -> `FrontEntry`.

The population ignores bounds on constants. A program that would enter the front is checked for all required variables
and fitted again within the bounds (`restrained`, ADR 0050). For noisy targets the next best programs of each size are
kept, too (`RunnersUp`); this class only stores measured programs.
"""

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from atoll_core.expression.operators import ARITY, CONSTANT, NEGATE, SUBTRACT
from atoll_core.expression.program import Program, constant_places, tree_size
from atoll_core.expression.restrictions import EquationBounds, Restrictions
from atoll_core.expression.text.infix import PRINTABLE_SIZE
from atoll_core.expression.writing.shortest import collected
from atoll_core.search.pareto import FrontEntry, merge, runners_up
from atoll_island_worker.evolution.kernels.offers import (
    SIMPLE,
    SIMPLE_COEFFICIENTS,
    WITHOUT_SHIFT,
    choose_near,
    choose_offers,
    refit,
    refit_offers,
    structure_hash,
    write_variant,
)
from atoll_island_worker.evolution.kernels.tape import canonical_tape
from atoll_island_worker.evolution.setup import IslandSetup
from atoll_island_worker.evolution.structures import (
    MOST_FITTED,
    MOST_TERMS,
    Book,
    Fit,
    Floats,
    Ints,
    Lists,
    Rows,
    Scratch,
    Tape,
    empty_book,
)


class Node(NamedTuple):
    """One node: operator code, arguments (or the variable's index), and the value of a constant."""

    code: int
    left: int = 0
    right: int = 0
    constant: float = 0.0


Formula = tuple[Node, ...]
"""Nodes in order; the last one is the output."""


def from_tape(tape: Tape, count: int) -> Formula:
    """Return the first `count` nodes of `tape`."""
    return _nodes(tape.code[:count], tape.left[:count], tape.right[:count], tape.constants[:count])


def from_book(book: Book, k: int) -> Formula:
    """Return program `k` of `book`."""
    count = int(book.size[k])
    return _nodes(book.code[k, :count], book.left[k, :count], book.right[k, :count], book.constants[k, :count])


def onto_tape(formula: Formula, tape: Tape) -> int:
    """Write `formula` on `tape`; return its number of nodes. The tape must be long enough."""
    for i, node in enumerate(formula):
        tape.code[i], tape.left[i], tape.right[i], tape.constants[i] = node.code, node.left, node.right, node.constant
    return len(formula)


def from_program(program: Program) -> Formula:
    """Return the nodes of `program`."""
    return _nodes(program.operators, program.left, program.right, program.constants)


def _nodes(*columns: npt.NDArray[Any]) -> Formula:
    return tuple(map(Node, *(column.tolist() for column in columns)))


def to_program(formula: Formula) -> Program:
    """Return `formula`, which must have no dead nodes, as a canonical program."""
    return Program(
        np.array([node.code for node in formula], np.int8),
        np.array([node.left for node in formula], np.int16),
        np.array([node.right for node in formula], np.int16),
        np.array([node.constant for node in formula]),
    )


def reductions(formula: Formula) -> Iterator[Formula]:
    """Yield `formula` with one operator replaced by one of its arguments or by a constant, from the output downwards.

    A difference is also replaced by its negative part alone.
    """
    for i in range(len(formula) - 1, -1, -1):
        arity = ARITY[formula[i].code]
        if arity == 0:
            continue
        yield _redirected(formula, i, formula[i].left)
        if arity == 2 and formula[i].right != formula[i].left:
            yield _redirected(formula, i, formula[i].right)
        if formula[i].code == SUBTRACT:
            yield (*formula[:i], Node(NEGATE, formula[i].right), *formula[i + 1 :])
        yield (*formula[:i], Node(CONSTANT, constant=1.0), *formula[i + 1 :])


def _redirected(formula: Formula, old: int, new: int) -> Formula:
    """Return `formula` with every use of node `old` replaced by the earlier node `new`."""
    if old == len(formula) - 1:
        return formula[: new + 1]

    def turned(node: Node) -> Node:
        arity = ARITY[node.code]
        left = new if arity > 0 and node.left == old else node.left
        right = new if arity > 1 and node.right == old else node.right
        return Node(node.code, left, right, node.constant)

    return (*formula[: old + 1], *(turned(node) for node in formula[old + 1 :]))


Refit = Callable[[int], None]
"""A function that fits the constants of the program on the canonical tape, whose number of nodes it takes. Held
constants (`Work.held`) are not changed."""


def restrained(program: Program, restrictions: Restrictions, scratch: Scratch, refit: Refit) -> Program | None:
    """Return `program` fitted within its bounds and measured by `refit`; None if it violates a restriction."""
    if restrictions.are_kept(program):
        return program
    admitted = restrictions.admitted(program)
    if admitted is None or restrictions.bounds is None or len(admitted) > len(scratch.canonical.code):
        return None
    fitted = _fitted(restrictions.bounds.clipped(admitted), restrictions.bounds, scratch, refit)
    if not np.any(fitted.constants[constant_places(fitted)] == 0.0):
        return fitted if restrictions.has_shapes(fitted) else None
    shorter = restrictions.admitted(collected(fitted))  # without terms whose coefficients have become zero
    if shorter is None:
        return None
    fitted = _fitted(restrictions.bounds.clipped(shorter), restrictions.bounds, scratch, refit)
    return fitted if restrictions.has_shapes(fitted) else None


def _fitted(program: Program, bounds: EquationBounds, scratch: Scratch, refit: Refit) -> Program:
    """Return a program with its constants fitted within the bounds; constants that reach a bound stay there.

    Each round holds at least one more constant, so there are at most as many rounds as constants.
    """
    ranges, places = bounds.ranges(program), constant_places(program)
    assert ranges is not None
    held, tape = scratch.work.held, scratch.canonical
    size = onto_tape(from_program(program), tape)
    while True:
        values = tape.constants[places]
        held[:size] = False
        held[places] = (values <= ranges[0]) | (values >= ranges[1])
        refit(size)
        clipped = np.clip(tape.constants[places], *ranges)
        is_within = np.array_equal(clipped, tape.constants[places])
        tape.constants[places] = clipped
        if is_within:
            held[:size] = False
            return to_program(from_tape(tape, size))


KNOWN = 4096
"""Size of the table of structures that were offered before, a power of two; see `kernels.offers.choose_near`."""

_WRITTEN = 2 * MOST_TERMS + 2
"""Largest number of nodes that a program gains when its coefficients are written into it."""


class RunnersUp:
    """At most `most` entries of each complexity in addition to the front, sorted by complexity and error.

    `known` (KNOWN,) are hashes of structures that were offered before; empty if no runners-up are kept.
    """

    def __init__(self, most: int) -> None:
        self.most = most
        self.known = np.zeros(KNOWN if most else 0, np.uint64)
        self._worst: dict[int, float] = {}
        self._entries: tuple[FrontEntry, ...] = ()

    @property
    def entries(self) -> tuple[FrontEntry, ...]:
        """All entries."""
        return self._entries

    def replace(self, entries: Iterable[FrontEntry]) -> None:
        """Restore saved entries."""
        self._entries = tuple(entries)
        self._note_worst()

    def take(
        self, front: tuple[FrontEntry, ...], candidates: Iterable[FrontEntry], reported: Iterable[FrontEntry]
    ) -> list[FrontEntry]:
        """Keep the runners-up of `front` among the candidates; return new ones that were not `reported` already."""
        seen = {entry.key for entry in (*self._entries, *reported)}
        self._entries = runners_up(front, (*self._entries, *candidates), self.most)
        self._note_worst()
        return [entry for entry in self._entries if entry.key not in seen]

    def limits(self, sizes: int) -> npt.NDArray[np.float64]:
        """Return the largest useful loss of programs by size (sizes,), before their coefficients are written into them.

        A program with a larger loss ranks after at least `most` other entries of its complexity, now and later.
        """
        worst = [self._worst.get(complexity, math.inf) for complexity in range(sizes + _WRITTEN + 1)]
        return np.array([max(worst[size : size + _WRITTEN + 1]) for size in range(sizes)])

    def limit(self, complexity: int) -> float:
        """Return the loss above which a program of that complexity is no runner-up."""
        return self._worst.get(complexity, math.inf)

    def _note_worst(self) -> None:
        """Record the largest error of each complexity that has `most` entries."""
        taken: dict[int, int] = {}
        self._worst = {}
        for entry in self._entries:
            taken[entry.complexity] = taken.get(entry.complexity, 0) + 1
            if taken[entry.complexity] == self.most:
                self._worst[entry.complexity] = entry.error


REFIT_STEPS = 10
POLISH_STEPS = 4
PRUNE_STEPS = 15
MOST_NODES = 200
_NEAR = 2.0
_NEAR_EXACT = 1e-6
_PROMISING = 10.0
_POLISHED = 0.95
"""Refining the constants of a program again is expected to reduce its loss at most to this share."""

_UNSCALED: Final = -1
"""The variant without coefficients, see `write_variant`."""

_SLACK = 1.2
"""If runners-up are kept: constants are refined for individuals with a loss up to this factor above the useful loss."""

Tag = tuple[int, int, int]
"""Epoch, generation and island of an entry."""
Additions = tuple[list[FrontEntry], list[FrontEntry]]
"""Additions to the front and to the runners-up, each in the order found."""


class Front:
    """Non-dominated `entries` by rising complexity and falling error. Among equal entries the earliest is kept."""

    def __init__(self) -> None:
        self._keep(())

    def _keep(self, entries: tuple[FrontEntry, ...]) -> None:
        self._entries = entries
        self._complexities = [entry.complexity for entry in entries]
        self._least: Floats | None = None

    @property
    def entries(self) -> tuple[FrontEntry, ...]:
        """All entries."""
        return self._entries

    def replace(self, entries: Iterable[FrontEntry]) -> None:
        """Restore a saved front."""
        self._keep(merge((), entries))

    def least_error(self) -> float | None:
        """Return the smallest error, None while the front is empty."""
        return self._entries[-1].error if self._entries else None

    def error_at(self, complexity: int) -> float:
        """Return the least error of entries with at most this complexity; inf if there is none."""
        place = bisect_right(self._complexities, complexity)
        return self._entries[place - 1].error if place else math.inf

    def least_by_size(self, sizes: int) -> Floats:
        """Return `error_at` for each complexity below `sizes`, shape (sizes,); the caller must not change it."""
        if self._least is None or len(self._least) != sizes:
            self._least = np.full(sizes, math.inf)
            for entry in self._entries:
                self._least[entry.complexity :] = entry.error
        return self._least

    def add(self, entry: FrontEntry) -> bool:
        """Add `entry` if its error is smaller than `error_at` its complexity; return whether it was added."""
        if not entry.error < self.error_at(entry.complexity):
            return False
        self._keep(merge(self._entries, (entry,)))
        return True


class FrontUpdater:
    """Offers individuals to a front, and to its runners-up if these are kept.

    `offered` and `offered_loss` (sizes,) are hash and loss of the last structure of each size that was offered to the
    front.
    """

    def __init__(self, setup: IslandSetup, front: Front, runners_up: RunnersUp) -> None:
        self._setup = setup
        self._front = front
        self._runners_up = runners_up
        sizes, nodes = setup.scratch.best_of_size.shape[0], setup.scratch.book.code.shape[1]
        population = setup.config.evolution.population
        self._book = empty_book(sizes + population, nodes) if runners_up.most else setup.scratch.book
        self._individuals = np.zeros(len(self._book.size), np.int64)
        self._candidates: list[FrontEntry] = []
        self._measured_loss: dict[int, float] = {}
        self.offered = np.zeros(sizes, np.uint64)
        self.offered_loss = np.full(sizes, math.inf)
        self._scale = np.zeros(1 + MOST_TERMS)
        self._result = np.zeros(2)
        self._unscaled = Fit(setup.fit.steps, 0, MOST_FITTED, setup.fit.loss, math.inf)
        self._largest = setup.config.space.max_size or MOST_NODES

    def offer(self, lists: Lists, fitness: Floats, counters: Ints, tag: Tag, offers_next_best: bool) -> Additions:
        """Measure the best of each size on all rows and offer it; return the additions to front and runners-up.

        With `offers_next_best`, the next best of each size are offered as well, if runners-up are kept.
        """
        setup = self._setup
        offers_next_best = offers_next_best and self._runners_up.most > 0
        number, least = self._choose(lists, fitness, offers_next_best)
        count = setup.call(
            refit_offers, lists, self._individuals, number, setup.every, setup.fit,
            REFIT_STEPS if setup.fit.steps else 0,
            setup.scratch, least, _SLACK if offers_next_best else math.inf, self._book, counters,
        )  # fmt: skip
        before = self._front.entries
        additions = [entry for k in range(count) for entry in self._offer_one(k, counters, tag)]
        if not self._candidates:
            return additions, []
        candidates, self._candidates = self._candidates, []
        return additions, self._runners_up.take(self._front.entries, (*before, *candidates), (*before, *additions))

    def _choose(self, lists: Lists, fitness: Floats, offers_next_best: bool) -> tuple[int, Floats]:
        """Choose individuals; return their number and, by size, the loss below which an individual is offered."""
        scratch, individuals, runners_up = self._setup.scratch, self._individuals, self._runners_up
        call = self._setup.call
        number = int(call(choose_offers, lists, fitness, scratch, self.offered, self.offered_loss, individuals))
        if not offers_next_best:
            return number, self._front.least_by_size(len(self.offered))
        order = np.argsort(fitness, kind="stable")
        most, known = runners_up.most, runners_up.known
        number = int(call(choose_near, lists, fitness, order, most, scratch, known, individuals, number))
        return number, runners_up.limits(len(self.offered))

    def _offer_one(self, k: int, counters: Ints, tag: Tag) -> Iterator[FrontEntry]:
        """Offer every way to write a program; a way that does not improve the front may be a runner-up."""
        book, keeps = self._book, self._runners_up.most > 0
        loss = float(book.loss[k])
        if not (keeps or loss < self._front.error_at(int(book.size[k]))):
            return
        limit = _NEAR * loss + _NEAR_EXACT * self._setup.deviation
        for variant, expected in self._variants(k, limit):
            entry = self._measured(k, variant, expected, counters, tag)
            if entry is None:
                continue
            if keeps:
                self._candidates.append(entry)
            if self._front.add(entry):
                yield entry

    def _error(self) -> float:
        """Return the loss of the last measurement, in the target's units."""
        return float(self._result[0]) if self._setup.fit.loss == 0 else math.sqrt(float(self._result[1]))

    def _variants(self, k: int, limit: float) -> Iterator[tuple[int, float]]:
        """Yield the ways to write the fitted coefficients that keep the loss within `limit`, with the loss of each.

        The programs are written with or without the shift, and with coefficients near 1 and -1 unchanged or exact. If
        sizes are limited, all of these programs may be too large, so the program without coefficients is included.
        """
        book = self._book
        if not self._setup.fit.terms:
            yield _UNSCALED, float(book.loss[k])
            return
        number = int(book.number[k])
        shift, *coefficients = book.scale[k, : 1 + number].tolist()
        plain = [math.copysign(1.0, a) if abs(abs(a) - 1.0) < SIMPLE else a for a in coefficients]
        is_unscaled = False
        for variant, loss in enumerate(book.variants[k].tolist()):
            if variant & SIMPLE_COEFFICIENTS and plain == coefficients:
                break
            if loss > limit or (variant & WITHOUT_SHIFT and shift == 0.0):  # without a shift of 0 nothing changes
                continue
            yield variant, loss
            written = plain if variant & SIMPLE_COEFFICIENTS else coefficients
            if variant & WITHOUT_SHIFT or shift == 0.0:
                is_unscaled |= self._is_unscaled(k, written)
        if self._setup.config.space.max_size is not None and not is_unscaled:
            yield _UNSCALED, float(book.loss[k])

    def _is_unscaled(self, k: int, coefficients: list[float]) -> bool:
        """Return whether program `k`, with these coefficients and without a shift, is the program itself."""
        terms = [(int(self._book.terms[k, j]), a) for j, a in enumerate(coefficients) if a != 0.0]
        return terms == [(int(self._book.size[k]) - 1, 1.0)]

    def _is_wanted(self, size: int, loss: float) -> bool:
        """Return whether the program on the canonical tape, with about this `loss`, is worth measuring.

        If runners-up are kept, many offered programs are not better than the present runners-up, or have a structure
        that was measured in this epoch already.
        """
        if not self._runners_up.most:
            return True
        loss *= _POLISHED
        structure = int(self._setup.call(structure_hash, self._setup.scratch.canonical, size))
        if not loss < min(self._runners_up.limit(size), self._measured_loss.get(structure, math.inf)):
            return loss < self._front.error_at(size)
        self._measured_loss[structure] = loss
        return True

    def begin_epoch(self) -> None:
        """Forget the data that are only needed within an epoch."""
        self._measured_loss.clear()

    def _measured(self, k: int, variant: int, expected: float, counters: Ints, tag: Tag) -> FrontEntry | None:
        """Return an entry for a variant of program `k` of the book with refined constants.

        None if it is too large, not finite, or neither improves the front nor is kept for other reasons.
        """
        setup, scratch = self._setup, self._setup.scratch
        size = int(setup.call(write_variant, self._book, k, variant, scratch))
        if size > self._largest or not self._is_wanted(size, expected):
            return None
        steps = POLISH_STEPS if setup.fit.steps else 0
        self._refit(size, setup.every, steps, counters)
        is_restricted = not setup.restrictions.are_none
        if not (is_restricted or self._runners_up.most or self._error() < self._front.error_at(size)):
            return None
        program: Program | None = to_program(from_tape(scratch.canonical, size))
        if program is not None and is_restricted:
            program = restrained(
                program, setup.restrictions, scratch, lambda nodes: self._refit(nodes, setup.every, steps, counters)
            )
        if program is None or not math.isfinite(self._error()) or tree_size(program) > PRINTABLE_SIZE:
            return None
        return self._entry(program, tag) if len(program) <= self._largest else None

    def _refit(self, size: int, rows: Rows, steps: int, counters: Ints) -> None:
        scratch = self._setup.scratch
        self._setup.call(
            refit, size, rows, self._unscaled, steps, scratch.canonical, scratch.work, self._scale, self._result,
            counters,
        )  # fmt: skip

    def _canonical(self, formula: Formula) -> int:
        """Put the canonical form of `formula` on the canonical tape; return its size."""
        scratch = self._setup.scratch
        count = onto_tape(formula, scratch.tape)
        return int(self._setup.call(canonical_tape, scratch.tape, count, scratch.work, scratch.canonical))

    def _entry(self, program: Program, tag: Tag) -> FrontEntry:
        return FrontEntry(len(program), self._error(), float(self._result[1]), *tag, program.to_bytes())

    def prune(self, target: float, counters: Ints, tag: Tag) -> list[FrontEntry]:
        """Remove parts of the simplest program that reaches `target` while its error stays at most `target`.

        One operator at a time is replaced by one of its arguments or by a constant, and the constants are fitted again.
        The first reduction that meets the target is kept, and the search for reductions begins again. Returns the
        additions to the front.
        """
        additions: list[FrontEntry] = []
        if not self._setup.fit.steps:
            return additions
        simplest = next(e for e in self._front.entries if e.error <= target)
        formula = from_program(Program.from_bytes(simplest.program, self._setup.space.variables))
        while (reduced := self._reduced(formula, target, counters)) is not None:
            formula = reduced
            entry = self._entry(to_program(formula), tag)
            if self._front.add(entry):
                additions.append(entry)
        return additions

    def _reduced(self, formula: Formula, target: float, counters: Ints) -> Formula | None:
        """Return the first smaller formula that meets `target`; the scratch arrays hold its measurement."""
        scratch = self._setup.scratch
        for candidate in reductions(formula):
            size = self._canonical(candidate)
            if size >= len(formula):
                continue
            self._refit(size, self._setup.equation.spread, PRUNE_STEPS, counters)
            if not self._error() <= _PROMISING * target:
                continue
            self._refit(size, self._setup.every, PRUNE_STEPS, counters)
            reduced = from_tape(scratch.canonical, size)
            if self._error() <= target and self._setup.restrictions.are_kept(to_program(reduced)):
                return reduced
        return None
