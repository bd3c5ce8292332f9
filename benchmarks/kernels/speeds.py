"""Measuring how fast kernels evaluate; ``benchmarks.kernels`` says what and prints it.

Seconds are those that this thread had a core, so that other programs on the machine disturb little.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.expression.operators import BY_NAME
from atoll_island_worker.evolution.kernels.measured_rows import padded_rows
from atoll_island_worker.evolution.structures import Lists, Rows
from benchmarks.kernels.corpus import Corpus
from benchmarks.kernels.loops import (
    REGISTER_STEPS,
    Instructions,
    Room,
    differentiate_repeatedly,
    fitness_by_numpy,
    forward_repeatedly,
    gradient_repeatedly,
    in_registers_repeatedly,
    instructions,
    measure_into,
    measure_repeatedly,
    multiply_add_repeatedly,
    operator_tape,
    room_for,
    values_by_numpy,
)

OPERATOR_NODES: Final = 30
IN_CACHE: Final = 1024
"""Numbers in each array of the loops that measure the peak: 8 KB, a quarter of a usual first cache."""

CLOSE: Final = 1e-6
"""Largest relative difference of a fitness from numpy's; sin and cos of large numbers multiply differences."""

_LEAST_S: Final = 0.01
"""Duration of one repetition, at least."""


@dataclass(frozen=True, eq=False)
class Part:
    """The lists of the corpus that come from one file, on some rows: `live` (P,) sizes, `programs` for numpy."""

    lists: Lists
    rows: Rows
    room: Room
    live: FloatArray
    programs: list[Instructions]

    @property
    def nodes(self) -> float:
        """Node evaluations of one pass."""
        return float(self.live.sum()) * self.rows.length

    @property
    def points(self) -> float:
        """Point evaluations of one pass."""
        return float(len(self.live)) * self.rows.length


@dataclass(frozen=True)
class Peak:
    """Operations a second of multiply-adds: over arrays in the first cache, and in registers."""

    in_cache: float
    in_registers: float


@dataclass(frozen=True)
class Speed:
    """Evaluations a second of all lists on so many rows.

    `points` and `nodes` are of lists measured one after the other; `numpy_ratio` is how many times as fast as numpy
    that is.
    """

    rows: int
    points: float
    nodes: float
    gradient_points: float
    gradient_nodes: float
    numpy_ratio: float


@dataclass(frozen=True)
class OperatorSpeed:
    """Node evaluations a second of one operator on so many rows."""

    operator: str
    rows: int
    nodes: float
    gradient_nodes: float
    numpy_ratio: float


def fastest(call: Callable[[int], object], repetitions: int) -> float:
    """Return the seconds that one time takes when ``call(times)`` does something `times` times, once compiled."""
    call(1)
    times = 1
    while (seconds := _timed(call, times)) < _LEAST_S:
        times = max(2 * times, int(times * _LEAST_S / max(seconds, 1e-6)))
    return min(_timed(call, times) for _ in range(repetitions)) / times


def _timed(call: Callable[[int], object], times: int) -> float:
    begun = time.thread_time()
    call(times)
    return time.thread_time() - begun


def parts_of(corpus: Corpus, rows: int) -> list[Part]:
    """Return the corpus by file, each on its rows repeated until there are `rows`."""
    parts = []
    for file in range(len(corpus.names)):
        lists = corpus.lists_of(file)
        index = np.arange(rows) % corpus.target.shape[1]
        inputs = np.ascontiguousarray(corpus.inputs[file][:, index])
        measured = padded_rows(inputs, corpus.target[file][index], keeps_waves=True)
        room = room_for(corpus.code.shape[1], measured)
        programs = [instructions(lists, p, room.tape) for p in range(len(lists.code))]
        live = np.array([len(each) for each in programs], np.float64)
        parts.append(Part(lists, measured, room, live, programs))
    return parts


def wrong(parts: Sequence[Part]) -> int:
    """Return how many lists have a fitness that is not numpy's: infinite for what is not finite, else `CLOSE`."""
    number = 0
    for part in parts:
        fitness = np.empty(len(part.live))
        measure_into(fitness, part.lists, part.rows, part.room)
        inputs, target = part.rows.inputs[:, : part.rows.length], part.rows.target[0, : part.rows.length]
        expected = fitness_by_numpy(part.programs, inputs, target)
        expected[~np.isfinite(expected)] = np.inf
        both = np.isfinite(fitness) & np.isfinite(expected)
        with np.errstate(all="ignore"):
            number += int((both & ~(np.abs(fitness - expected) <= CLOSE * np.abs(expected))).sum())
        number += int((np.isfinite(fitness) != np.isfinite(expected)).sum())
    return number


def peak(repetitions: int) -> Peak:
    """Measure the machine's multiply-adds."""
    x = np.linspace(0.1, 0.4, IN_CACHE)
    out = np.zeros(IN_CACHE)
    in_cache = fastest(lambda times: multiply_add_repeatedly(times, out, x), repetitions)
    in_registers = fastest(lambda times: in_registers_repeatedly(times, out, x), repetitions)
    return Peak(2 * IN_CACHE / in_cache, 2 * REGISTER_STEPS * IN_CACHE / in_registers)


def seconds(loop: Callable[..., None], parts: Sequence[Part], repetitions: int) -> float:
    """Return the seconds of one pass of `loop` over all lists."""
    return sum(fastest(_passes(loop, part), repetitions) for part in parts)


def _passes(loop: Callable[..., None], part: Part) -> Callable[[int], None]:
    fitness = np.empty(len(part.live))
    return lambda times: loop(times, fitness, part.lists, part.rows, part.room)


def numpy_seconds(parts: Sequence[Part]) -> float:
    """Return the seconds of one pass by numpy over all lists, whose live nodes are known beforehand."""
    begun = time.thread_time()
    for part in parts:
        fitness_by_numpy(part.programs, part.rows.inputs, part.rows.target[0])
    return time.thread_time() - begun


def speed(parts: Sequence[Part], repetitions: int) -> Speed:
    """Measure all lists on the rows of `parts`."""
    points, nodes = sum(part.points for part in parts), sum(part.nodes for part in parts)
    forward, gradient = (seconds(loop, parts, repetitions) for loop in (measure_repeatedly, differentiate_repeatedly))
    numpy = min(numpy_seconds(parts) for _ in range(3))
    return Speed(
        rows=parts[0].rows.length,
        points=points / forward,
        nodes=nodes / forward,
        gradient_points=points / gradient,
        gradient_nodes=nodes / gradient,
        numpy_ratio=numpy / forward,
    )


def operator_speed(name: str, rows: int, repetitions: int) -> OperatorSpeed:
    """Measure `OPERATOR_NODES` nodes of one operator on arguments between 0.5 and 2."""
    inputs = np.ascontiguousarray(np.linspace((0.5, 2.0), (2.0, 0.5), rows).T)
    measured = padded_rows(inputs, np.zeros(rows))
    room = room_for(OPERATOR_NODES + 2, measured)
    count = operator_tape(BY_NAME[name].code, OPERATOR_NODES, room.tape)
    forward = fastest(lambda times: forward_repeatedly(times, count, measured, room), repetitions)
    gradient = fastest(lambda times: gradient_repeatedly(times, count, measured, room), repetitions)
    tape = room.tape
    program = list(zip(*(part.tolist() for part in (tape.code, tape.left, tape.right, tape.constants)), strict=True))
    numpy = min(_timed(lambda _: values_by_numpy(program[:count], inputs), 1) for _ in range(5 * repetitions))
    nodes = OPERATOR_NODES * rows
    return OperatorSpeed(name, rows, nodes / forward, nodes / gradient, numpy / forward)
