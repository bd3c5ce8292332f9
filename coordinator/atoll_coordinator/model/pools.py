"""The input of refining: the pools of the search, and the laws that a sparse regression found. Pure."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from atoll_core.expression.program import MAX_NODES, Program, tree_size
from atoll_core.expression.text.infix import PRINTABLE_SIZE
from atoll_core.search.pareto import FrontEntry

Origin = Literal["front", "runner-up", "guess", "library", "descent", "known"]
"""Where an equation comes from: the front or the runners-up of the search, a guess, a library of terms, a known
equation, or a descent from any of these to a shorter description. Constants may have been fitted and rounded since."""


@dataclass(frozen=True)
class Pool:
    """The candidates that the search has found for one variable.

    `front` has for each complexity the program of least error, if no simpler one is as good; `runners_up` the next best
    of each complexity, distinct in function, by (complexity, error).
    """

    front: tuple[FrontEntry, ...]
    runners_up: tuple[FrontEntry, ...] = ()


Pools = Mapping[str, Pool]
"""The pool of each variable, by name."""


@dataclass(frozen=True, eq=False)
class Law:
    """A sum of products: its `program`, the `nats` by which laws of one state are compared, and how well it fits.

    `excess` is how many times as large as the noise, or as the limit of convergence, the errors are. `is_tested` tells
    whether there are enough rows for the largest library that it was chosen from. `lead` is how many nats longer the
    best program is that was compared with it and is no sum of products. `probability` is the probability of errors as
    large as these if all are noise. `is_of_rates`: it was found among many variables, by derivatives.
    """

    program: Program
    nats: float
    excess: float
    is_tested: bool
    lead: float = math.inf
    probability: float = 1.0
    is_of_rates: bool = False


LawsByGroup = Sequence[Mapping[str, tuple[Law, ...]]]
"""By variable, its laws: a mapping for each group of trajectories, one for all where there are no groups."""


@dataclass(frozen=True, eq=False)
class Member:
    """A member of a front: its program, and its loss and mean squared error on all rows."""

    program: Program
    error: float
    mse: float


def decode_members(entries: Sequence[FrontEntry], inputs: int) -> tuple[Member, ...]:
    """Return the members of a front; `inputs` is how many variables there are."""
    return tuple(Member(Program.from_bytes(entry.program, inputs), entry.error, entry.mse) for entry in entries)


def may_be_shown(program: Program, largest: int | None) -> bool:
    """Tell whether a program can be printed and is no larger than `largest`, the user's limit (None: no limit)."""
    return len(program) <= min(largest or MAX_NODES, MAX_NODES) and tree_size(program) <= PRINTABLE_SIZE
