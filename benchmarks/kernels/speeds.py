"""Measure the speed of evaluation in the kernels; ``benchmarks.kernels`` chooses the measurements and prints them.

All times are CPU seconds of this thread, so that other programs on the machine have little influence.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.expression.operators import BY_NAME
from atoll_island_worker.evolution.kernels.measured_rows import padded_rows
from atoll_island_worker.evolution.kernels.tape import compile_tape
from atoll_island_worker.evolution.structures import Lists, Rows
from benchmarks.kernels.corpus import Corpus
from benchmarks.kernels.loops import (
    Room,
    differentiate_repeatedly,
    forward_repeatedly,
    gradient_repeatedly,
    measure_repeatedly,
    operator_tape,
    room_for,
)

OPERATOR_NODES: Final = 30
_LEAST_S: Final = 0.01
"""Shortest duration of one repetition."""


@dataclass(frozen=True, eq=False)
class Part:
    """The lists of the corpus that come from one file, and its rows; `live` (P,) are their sizes without dead nodes."""

    lists: Lists
    rows: Rows
    room: Room
    live: FloatArray

    @property
    def nodes(self) -> float:
        """Node evaluations in one pass over the lists."""
        return float(self.live.sum()) * self.rows.length

    @property
    def points(self) -> float:
        """Point evaluations in one pass over the lists."""
        return float(len(self.live)) * self.rows.length


@dataclass(frozen=True)
class Speed:
    """Evaluations per second of all lists, one list after the other, on this number of `rows`."""

    rows: int
    points: float
    nodes: float
    gradient_points: float
    gradient_nodes: float


@dataclass(frozen=True)
class OperatorSpeed:
    """Node evaluations per second of one operator on this number of `rows`."""

    operator: str
    rows: int
    nodes: float
    gradient_nodes: float


def fastest(call: Callable[[int], object], repetitions: int) -> float:
    """Return the seconds of one iteration, where ``call(times)`` does `times` iterations; compilation not included."""
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
    """Return the corpus by file; the 16 rows of each file are repeated until there are `rows` rows."""
    parts = []
    for file in range(len(corpus.names)):
        lists = corpus.lists_of(file)
        index = np.arange(rows) % corpus.target.shape[1]
        inputs = np.ascontiguousarray(corpus.inputs[file][:, index])
        measured = padded_rows(inputs, corpus.target[file][index], keeps_waves=True)
        room = room_for(corpus.code.shape[1], measured)
        live = np.array([compile_tape(lists, p, room.tape) for p in range(len(lists.code))], np.float64)
        parts.append(Part(lists, measured, room, live))
    return parts


def seconds(loop: Callable[..., None], parts: Sequence[Part], repetitions: int) -> float:
    """Return the seconds of one pass of `loop` over all lists."""
    return sum(fastest(_passes(loop, part), repetitions) for part in parts)


def _passes(loop: Callable[..., None], part: Part) -> Callable[[int], None]:
    fitness = np.empty(len(part.live))
    return lambda times: loop(times, fitness, part.lists, part.rows, part.room)


def speed(parts: Sequence[Part], repetitions: int) -> Speed:
    """Return the speed of all lists on the rows of `parts`, without and with gradient."""
    points, nodes = sum(part.points for part in parts), sum(part.nodes for part in parts)
    forward, gradient = (seconds(loop, parts, repetitions) for loop in (measure_repeatedly, differentiate_repeatedly))
    return Speed(parts[0].rows.length, points / forward, nodes / forward, points / gradient, nodes / gradient)


def operator_speed(name: str, rows: int, repetitions: int) -> OperatorSpeed:
    """Measure `OPERATOR_NODES` nodes of one operator on arguments between 0.5 and 2."""
    inputs = np.ascontiguousarray(np.linspace((0.5, 2.0), (2.0, 0.5), rows).T)
    measured = padded_rows(inputs, np.zeros(rows))
    room = room_for(OPERATOR_NODES + 2, measured)
    count = operator_tape(BY_NAME[name].code, OPERATOR_NODES, room.tape)
    forward = fastest(lambda times: forward_repeatedly(times, count, measured, room), repetitions)
    gradient = fastest(lambda times: gradient_repeatedly(times, count, measured, room), repetitions)
    nodes = OPERATOR_NODES * rows
    return OperatorSpeed(name, rows, nodes / forward, nodes / gradient)
