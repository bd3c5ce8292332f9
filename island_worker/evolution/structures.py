"""The arrays that kernels work on, grouped.

Letters: P population, L list length, T terminals, V variables, K predictors, R rows.
NamedTuples of arrays, since numba passes them as they are; shapes are set once, in `allocate`-style functions here, and
trusted by the kernels.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from common.expression.kernels import LANES, padded

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Bytes = npt.NDArray[np.int8]
Shorts = npt.NDArray[np.int16]
Booleans = npt.NDArray[np.bool_]
Hashes = npt.NDArray[np.uint64]


class Lists(NamedTuple):
    """Operation lists of several individuals, dead nodes included. Node i < T is a terminal; the last is the output."""

    code: Bytes
    """(P, L) operator codes."""
    left: Shorts
    """(P, L) earlier node, or the variable's index at VARIABLE nodes."""
    right: Shorts
    """(P, L) earlier node; kept, and varied, also where the operator is unary."""
    constants: Floats
    """(P, L) value at CONSTANT nodes; elsewhere dormant."""
    scale: Floats
    """(P, 1 + MOST_TERMS) b, a_1, ...: the output is b + a_1 t_1 + ... for the list's top-level terms t_j."""


class Space(NamedTuple):
    """The space that lists are drawn from."""

    terminals: int
    nodes: int
    variables: int
    operators: Ints
    """Codes to choose from."""
    scales: Floats
    """Scales of columns and target (powers of two, 1 when of order 1), for drawing constants; empty: [-10, 10]."""
    crossover: float
    mutation: float


class Fit(NamedTuple):
    """How constants are fitted."""

    steps: int
    """Levenberg-Marquardt steps for the constants inside terms; 0: none."""
    terms: int
    """Most top-level terms with a fitted coefficient; 0: the program is taken as it stands."""
    least: int
    """Inner constants that may be fitted however few rows there are."""
    loss: int
    """0: mean absolute error, 1: mean squared error."""


class Rows(NamedTuple):
    """Rows of the problem that a measurement is made on, padded to a multiple of LANES by repeating the last."""

    inputs: Floats
    """(V, padded)."""
    target: Floats
    """(padded,)."""
    length: int
    """Rows before the padding."""


class Tape(NamedTuple):
    """Scratch for one program's live nodes, see `common.expression.kernels`."""

    code: Ints
    left: Ints
    right: Ints
    constants: Floats
    depends: Booleans
    origin: Ints
    """Index in the list that each live node came from."""
    live: Ints
    """(L,) -1 for dead nodes of the list, else the index on the tape."""


class Work(NamedTuple):
    """Scratch of the fit: values, adjoints and normal equations."""

    values: Floats
    """(nodes, padded rows)."""
    adjoints: Floats
    """(nodes, LANES)."""
    lanes: Floats
    output: Floats
    """(padded rows,)."""
    columns: Floats
    """(most fitted + 1, LANES) columns of the Jacobian and, after the last, the residual."""
    matrix: Floats
    damped: Floats
    gradient: Floats
    step: Floats
    means: Floats
    terms: Ints
    """Tape indices of the top-level terms; `number` of them."""
    number: Ints
    fitted: Ints
    """Tape indices of the constants that are fitted."""
    feeds: Booleans
    """Whether a node is part of a term."""
    kept: Floats
    kept_scale: Floats
    trial: Floats


class Coevolution(NamedTuple):
    """Fitness predictors and their trainers (paper, section 2.3)."""

    predictors: Ints
    """(K, rows) indices of rows, repeats allowed."""
    quality: Floats
    """(K,) mean absolute difference of predicted and exact fitness over the trainers; lower is better."""
    trainers: Lists
    exact: Floats
    """(trainers,) exact fitness."""
    losses: Floats
    """(trainers, R) loss at every row; follows from the trainers, so it is not part of a checkpoint."""
    born: Ints
    """(trainers,) predictor generation at which each was taken on."""
    best: Ints
    """(1,) index of the predictor that measures the solutions now."""
    clock: Ints
    """(1,) predictor generations so far."""


class Coevolving(NamedTuple):
    """Whether and how predictors coevolve."""

    enabled: int
    effort: float
    renewal: int


class Scratch(NamedTuple):
    """Everything a generation needs besides the island's own state."""

    order: Ints
    pair: Ints
    children: Lists
    child_fitness: Floats
    live: Ints
    """(4, L): which nodes of the two parents and the two children are live."""
    tape: Tape
    canonical: Tape
    work: Work
    result: Floats
    spare: Rows
    """Rows for one predictor at a time."""
    predictor_children: Ints
    best_of_size: Ints
    hashes: Hashes


MOST_FITTED = 12
"""Constants inside terms that are fitted at most in one program."""

MOST_TERMS = 4
"""Top-level terms with a coefficient of their own, at most."""


def empty_lists(population: int, nodes: int) -> Lists:
    """Return lists of `population` individuals with `nodes` nodes each, all zero, unscaled."""
    shape = (population, nodes)
    scale = np.zeros((population, 1 + MOST_TERMS))
    scale[:, 1] = 1.0
    return Lists(np.zeros(shape, np.int8), np.zeros(shape, np.int16), np.zeros(shape, np.int16), np.zeros(shape), scale)


def empty_tape(nodes: int) -> Tape:
    """Return scratch for a tape of at most `nodes` nodes."""
    ints = [np.zeros(nodes, np.int64) for _ in range(5)]
    return Tape(ints[0], ints[1], ints[2], np.zeros(nodes), np.zeros(nodes, np.bool_), ints[3], ints[4])


def empty_work(nodes: int, rows: int) -> Work:
    """Return scratch to fit programs of at most `nodes` nodes on at most `rows` rows."""
    most = MOST_FITTED + MOST_TERMS + 2
    return Work(
        values=np.zeros((nodes, padded(rows))),
        adjoints=np.zeros((nodes, LANES)),
        lanes=np.zeros(LANES),
        output=np.zeros(padded(rows)),
        columns=np.zeros((most, LANES)),
        matrix=np.zeros((most, most)),
        damped=np.zeros((most, most)),
        gradient=np.zeros(most),
        step=np.zeros(most),
        means=np.zeros(MOST_TERMS),
        terms=np.zeros(MOST_TERMS + 2, np.int64),
        number=np.zeros(1, np.int64),
        fitted=np.zeros(MOST_FITTED, np.int64),
        feeds=np.zeros(nodes, np.bool_),
        kept=np.zeros(MOST_FITTED),
        kept_scale=np.zeros(1 + MOST_TERMS),
        trial=np.zeros(2),
    )


def empty_scratch(population: int, nodes: int, variables: int, sample: int, rows: int) -> Scratch:
    """Return scratch for an island: `sample` rows in a predictor, `rows` in all."""
    space = nodes + 4 + 3 * MOST_TERMS
    return Scratch(
        order=np.zeros(population, np.int64),
        pair=np.zeros(2, np.int64),
        children=empty_lists(2, nodes),
        child_fitness=np.zeros(2),
        live=np.zeros((4, nodes), np.int64),
        tape=empty_tape(space),
        canonical=empty_tape(space),
        work=empty_work(space, rows),
        result=np.zeros(2),
        spare=Rows(np.zeros((variables, padded(sample))), np.zeros(padded(sample)), sample),
        predictor_children=np.zeros((2, sample), np.int64),
        best_of_size=np.zeros(space, np.int64),
        hashes=np.zeros(population, np.uint64),
    )


def padded_rows(inputs: Floats, target: Floats) -> Rows:
    """Return `inputs` (V, R) and `target` (R,) padded by repeating the last row."""
    count = target.shape[0]
    index = np.minimum(np.arange(padded(count)), count - 1)
    return Rows(np.ascontiguousarray(inputs[:, index]), np.ascontiguousarray(target[index]), count)
