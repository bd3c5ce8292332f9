"""The input of refining: the pools of the search, and the laws that a sparse regression found. Pure."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from atoll_core.expression.program import MAX_NODES, Program, tree_size
from atoll_core.expression.text.infix import PRINTABLE_SIZE
from atoll_core.search.pareto import FrontEntry

Origin = Literal["front", "runner-up", "guess", "library", "descent", "known"]
"""The origin of an equation: the front or the runners-up of the search, a guess, a library of terms, a known equation,
or a local search that began with one of these equations. The constants of the equation may have been fitted and rounded
later."""


@dataclass(frozen=True)
class Pool:
    """The candidates that the search has found for one variable.

    `front` has at most one program of each complexity: the program of least error, if no simpler program has an error
    as small. `runners_up` has the next best programs of each complexity, sorted by (complexity, error). No two of them
    are the same function.
    """

    front: tuple[FrontEntry, ...]
    runners_up: tuple[FrontEntry, ...] = ()


Pools = Mapping[str, Pool]
"""The pool of each variable, by name."""


@dataclass(frozen=True, eq=False)
class Law:
    """A law found by sparse regression: its `program`, its `nats` (to compare laws of one state), and its fit.

    `excess` is the ratio of the residuals to the noise, or to the limit of convergence. `is_tested` tells whether there
    were enough rows to try the library of the highest degree. `lead` is a difference of lengths in nats: the length of
    the best compared program that is no sum of products, minus the length of the law. `probability` is the probability
    of residuals at least as large as the law's residuals, if all residuals are noise. `is_of_rates` tells whether the
    law was found among many variables, from derivatives.
    """

    program: Program
    nats: float
    excess: float
    is_tested: bool
    lead: float = math.inf
    probability: float = 1.0
    is_of_rates: bool = False


LawsByGroup = Sequence[Mapping[str, tuple[Law, ...]]]
"""For each group of trajectories, the laws of each variable by name. Without groups there is one mapping, for all
trajectories."""


@dataclass(frozen=True, eq=False)
class FrontMember:
    """A member of a front: its program, and its loss and mean squared error on all rows."""

    program: Program
    error: float
    mse: float


def decode_members(entries: Sequence[FrontEntry], inputs: int) -> tuple[FrontMember, ...]:
    """Return the decoded members of a front; `inputs` is the number of variables."""
    return tuple(FrontMember(Program.from_bytes(entry.program, inputs), entry.error, entry.mse) for entry in entries)


def may_be_shown(program: Program, largest: int | None) -> bool:
    """Tell whether a program can be printed and is no larger than `largest`, the user's limit (None: no limit)."""
    return len(program) <= min(largest or MAX_NODES, MAX_NODES) and tree_size(program) <= PRINTABLE_SIZE
