"""The corpus on which the speed of evaluation is measured: 1,000 offspring of searches with preset ``paper``.

Offspring as crossover and mutation make them, from the populations at generations 100, 200, ..., 1000 of all eight
islands of each of the 14 Strogatz label files; whole operation lists, dead nodes included, and 16 rows of each file.
``benchmarks/data/corpus.npz`` was written by ``python -m benchmarks.kernels --make-corpus --data DIR``; it stays as it
is, so that speeds measured at different times can be compared.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from atoll.terminal.output import note
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.data.reading.files import read_table
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Problem
from atoll_core.errors import DataError, UsageError
from atoll_core.expression.kernels.tape import LANES
from atoll_core.search.seeding import stream_key
from atoll_core.wire.codec import decode_arrays
from atoll_island_worker.evolution.island import Island
from atoll_island_worker.evolution.kernels.random import below
from atoll_island_worker.evolution.kernels.variation import copy_list, cross, mutate
from atoll_island_worker.evolution.setup import IslandSetup
from atoll_island_worker.evolution.structures import Lists, Space, empty_lists
from benchmarks.harness.jobs import UNMET, configured
from benchmarks.peers.strogatz import PUBLISHED
from benchmarks.peers.strogatz_files import LABEL

CORPUS: Final = Path(__file__).parent / "data" / "corpus.npz"
SIZE: Final = 1000
EPOCHS: Final = 10
"""Of 100 generations each."""

"""A target error that ends no search."""


@dataclass(frozen=True, eq=False)
class Corpus:
    """Operation lists of P individuals, in the order of the files that they come from, and rows of those files.

    `code`, `left`, `right` (P, L) and `constants` (P, L) are as in `atoll_island_worker.evolution.structures.Lists`;
    `origin` (P,) is an index into `names`, `generation` (P,) that of the parents. `inputs` (F, V, 16) and `target` (F,
    16) are evenly spaced rows of the F files.
    """

    names: npt.NDArray[np.str_]
    origin: npt.NDArray[np.int8]
    generation: npt.NDArray[np.int16]
    code: npt.NDArray[np.int8]
    left: npt.NDArray[np.int16]
    right: npt.NDArray[np.int16]
    constants: npt.NDArray[np.float64]
    inputs: npt.NDArray[np.float64]
    target: npt.NDArray[np.float64]

    def lists_of(self, file: int) -> Lists:
        """Return the lists that come from one file, unscaled."""
        chosen = self.origin == file
        parts = (self.code, self.left, self.right, self.constants)
        code, left, right, constants = (np.ascontiguousarray(part[chosen]) for part in parts)
        scale = empty_lists(len(code), self.code.shape[1]).scale
        return Lists(code, left, right, constants, scale)


def load_corpus(path: Path = CORPUS) -> Corpus:
    """Return the corpus in `path`; raises DataError when there is none."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            return Corpus(**{field.name: arrays[field.name] for field in fields(Corpus)})
    except (OSError, KeyError, TypeError, ValueError, EOFError, BadZipFile) as error:
        raise DataError(f"{path} is not a corpus of operation lists ({error}); check out the file anew") from error


def save_corpus(corpus: Corpus, path: Path) -> None:
    """Write `corpus`, compressed; raises UsageError when that is not possible."""
    arrays: dict[str, Any] = {field.name: getattr(corpus, field.name) for field in fields(Corpus)}
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as file:
            np.savez_compressed(file, **arrays)
    except OSError as error:
        raise UsageError(f"{path} cannot be written ({error.strerror}); name another file with --corpus") from error


def make_corpus(folder: Path, seed: int = 0, size: int = SIZE, names: Sequence[str] = tuple(PUBLISHED)) -> Corpus:
    """Search the files `names` in `folder` and return `size` offspring, as many of each as of any other; a minute.

    Raises:
        DataError: a file is missing or not as expected.
    """
    config = configured(seed, {"target": LABEL}, {"target_error": UNMET}, preset="paper")
    shares = [size // len(names) + (index < size % len(names)) for index in range(len(names))]
    tables = [read_table([folder / f"{name}.csv"], config.data) for name in names]
    problems = [prepare(table, config).dataset.problem(LABEL) for table in tables]
    found = []
    for name, problem, share in zip(names, problems, shares, strict=True):
        note(f"{name}: {share} offspring of {EPOCHS} epochs")
        found.append(_offspring(problem, config, share))
    lists = [part for part, _ in found]
    rows = [_spaced(problem) for problem in problems]
    return Corpus(
        names=np.array(names),
        origin=np.repeat(np.arange(len(names), dtype=np.int8), shares),
        generation=np.concatenate([generations for _, generations in found]),
        code=np.concatenate([part.code for part in lists]),
        left=np.concatenate([part.left for part in lists]),
        right=np.concatenate([part.right for part in lists]),
        constants=np.concatenate([part.constants for part in lists]),
        inputs=np.array([problem.inputs[:, chosen] for problem, chosen in zip(problems, rows, strict=True)]),
        target=np.array([problem.target.values[chosen] for problem, chosen in zip(problems, rows, strict=True)]),
    )


def _spaced(problem: Problem) -> npt.NDArray[np.int64]:
    """Return the indices of LANES rows, evenly spaced over all."""
    rows: int = problem.inputs.shape[1]
    return np.arange(LANES, dtype=np.int64) * rows // LANES


def _offspring(problem: Problem, config: JobConfig, share: int) -> tuple[Lists, npt.NDArray[np.int16]]:
    """Return `share` children with their parents' generations, spread evenly over all populations of a search."""
    space = IslandSetup(problem, config, 0).space
    populations = list(_populations(problem, config))
    chosen = [index * len(populations) // share for index in range(share)]
    children = empty_lists(share, space.nodes)
    for child, index in enumerate(chosen):
        key = stream_key(config.seed, problem.target.variable, child, index, "corpus")
        _breed_into(children, child, populations[index][1], space, np.array([key], np.uint64))
    return children, np.array([populations[index][0] for index in chosen], np.int16)


def _breed_into(children: Lists, child: int, parents: Lists, space: Space, stream: npt.NDArray[np.uint64]) -> None:
    """Write to place `child` one child of two random parents, as a generation would make it."""
    pair = empty_lists(2, space.nodes)
    population = parents.code.shape[0]
    first = int(below(stream, population))
    second = (first + 1 + int(below(stream, population - 1))) % population
    cross(pair, parents, first, second, space, stream)
    mutate(pair, 0, space, stream)
    copy_list(children, child, pair, 0)


def _populations(problem: Problem, config: JobConfig) -> Iterator[tuple[int, Lists]]:
    """Search for `EPOCHS` epochs and yield every island's population after each, with the generation."""
    islands = [Island(problem, config, index) for index in range(config.evolution.islands)]
    for epoch in range(1, EPOCHS + 1):
        for island in islands:
            while not island.advance(config.migration.generations):
                pass
        sent = [island.emigrants() for island in islands]
        for index, island in enumerate(islands):
            island.immigrate({source: blocks[index] for source, blocks in enumerate(sent) if index in blocks})
            yield epoch * config.migration.generations, _lists_of(island)


def _lists_of(island: Island) -> Lists:
    """Return the population of an island that is between two epochs."""
    _, arrays = decode_arrays(island.to_bytes())
    lists = Lists(*(np.ascontiguousarray(arrays[f"list {name}"]) for name in Lists._fields))
    return lists._replace(left=lists.left.astype(np.int16), right=lists.right.astype(np.int16))
