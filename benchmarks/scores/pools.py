"""A table and the systems that might be chosen for it: the law, and what is near it; what a score says of them."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Final, Literal

import numpy as np

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.selection.candidates import CandidateSet, form
from atoll_coordinator.model.selection.task import ModellingTask
from atoll_coordinator.model.structure.moves.extensions import extensions
from atoll_coordinator.model.structure.moves.neighbours import neighbours
from atoll_coordinator.model.structure.moves.reductions import reductions
from atoll_coordinator.service.jobs.defaults import resolve
from atoll_core.config import BASE_OPERATORS
from atoll_core.errors import DataError
from atoll_core.expression.program import Program, constant_places
from atoll_core.expression.text.parsing import from_infix
from atoll_core.expression.writing.shortest import shortest
from benchmarks.corpus.cases import LEAST_T, Key, make_case
from benchmarks.harness.jobs import configured

EXTENDED: Final = 6
TWICE: Final = 3
REDUCED: Final = 4
EXCHANGED: Final = 6
"""Systems of each kind, for each equation."""
TOGETHER: Final = 3
"""Systems all equations of which are extended."""

Kind = Literal["law", "extended", "reduced", "exchanged"]


@dataclass(frozen=True, eq=False)
class Pool:
    """The law of a table, first, and other systems by what was done to it.

    The law `is_identifiable` where each of its constants could be told from zero.
    """

    task: ModellingTask
    systems: tuple[tuple[Program, ...], ...]
    kinds: tuple[Kind, ...]
    is_identifiable: bool

    @property
    def constants(self) -> list[float]:
        """The constants of the law that are fitted, in the order of a system's."""
        return [float(program.constants[place]) for program in self.systems[0] for place in constant_places(program)]

    def count(self, place: int) -> int:
        """Return the number of constants of a system."""
        return sum(len(constant_places(program)) for program in self.systems[place])


def make_pool(key: Key) -> Pool | None:
    """Return the pool of one table of the corpus, None where the table is refused; equal keys give equal pools."""
    case = make_case(key, has_fresh=False)
    operators = (*BASE_OPERATORS, *case.system.operators)
    config = configured(key.seed, case.data, operators=operators)
    try:
        preparation = prepare(case.table, config)
    except DataError:
        return None
    if preparation.recording is None:
        return None
    dataset = preparation.dataset
    config = resolve(config, dataset)
    law = tuple(shortest(from_infix(case.system.truths[name], dataset.names)) for name in dataset.variables)
    task = ModellingTask(dataset, preparation.recording, config, {name: CandidateSet() for name in dataset.variables})
    draw = np.random.default_rng([key.seed, key.states, 4])
    kinds: list[Kind] = []
    systems: list[tuple[Program, ...]] = []
    known: set[tuple[bytes, ...]] = set()
    for kind, system in _systems(task, law, draw):
        forms = tuple(map(form, system))
        if forms not in known:
            known.add(forms)
            kinds.append(kind)
            systems.append(system)
    return Pool(task, tuple(systems), tuple(kinds), all(t >= LEAST_T for t in case.t.values()))


def _systems(
    task: ModellingTask, law: tuple[Program, ...], draw: np.random.Generator
) -> Iterator[tuple[Kind, tuple[Program, ...]]]:
    """Yield the law and systems near it."""
    yield "law", law
    scales = np.abs(task.dataset.inputs).mean(axis=1).tolist()
    longer: list[list[Program]] = []
    for place, name in enumerate(task.variables):
        operators, columns = task.operators(name), task.columns(name)
        own = [scale if column in columns else 0.0 for column, scale in enumerate(scales)]
        extended = _drawn(draw, extensions(law[place], own, operators), EXTENDED)
        twice = [
            program for first in extended[:TWICE] for program in _drawn(draw, extensions(first, own, operators), 1)
        ]
        longer.append(extended)
        made: list[tuple[Kind, Iterable[Program]]] = [
            ("extended", [*extended, *twice]),
            ("reduced", _drawn(draw, reductions(law[place]), REDUCED)),
            ("exchanged", _drawn(draw, neighbours(law[place], columns, operators), EXCHANGED)),
        ]
        for kind, programs in made:
            yield from ((kind, (*law[:place], program, *law[place + 1 :])) for program in programs)
    if len(law) > 1:
        yield from (("extended", system) for system in islice(zip(*longer, strict=False), TOGETHER))


def _drawn(draw: np.random.Generator, programs: Iterable[Program], count: int) -> list[Program]:
    every = list(programs)
    places = draw.permutation(len(every))[:count]
    return [every[place] for place in places.tolist()]


@dataclass(frozen=True)
class Scored:
    """Nats of the systems of a pool, less being better, and of these the misfits; infinite where one cannot be fitted.

    `estimates` and `errors` are the constants of the law as fitted and their standard errors; none where it cannot be.
    `note` is what else is to be known.
    """

    nats: tuple[float, ...]
    misfits: tuple[float, ...]
    estimates: tuple[float, ...] = ()
    errors: tuple[float, ...] = ()
    note: str = ""


def nothing(pool: Pool) -> Scored:
    """Return the scores of a pool of which no system can be fitted."""
    return Scored((math.inf,) * len(pool.systems), (math.inf,) * len(pool.systems))
