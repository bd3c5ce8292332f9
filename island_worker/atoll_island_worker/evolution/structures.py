"""The arrays that kernels work on, grouped.

Letters: P population, L list length, T terminals, V variables, K predictors, R rows.
NamedTuples of arrays, since numba passes them as they are; shapes are set once, in `allocate`-style functions here, and
trusted by the kernels.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from atoll_core.expression.kernels.tape import LANES, functions_address, padded

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
    steps: int = 0
    """How a constant is moved, see `variation`: 0: relative steps, 1: log-uniform ones."""
    moves: float = 0.5
    """Share of mutated constants that are moved; the others are drawn anew."""


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
    gate: float
    """A child takes steps only when its loss is at most this share of its worse parent's."""
    required: int = 0
    """Bits of the variables that individuals must have, those below `MOST_REQUIRED`; others have no finite loss."""


class Rows(NamedTuple):
    """Rows of the problem that a measurement is made on, padded to a multiple of LANES by repeating the last."""

    inputs: Floats
    """(V, padded)."""
    waves: Floats
    """(2 V, padded) sine and cosine of each input; (0, padded) when they are computed where they are needed."""
    target: Floats
    """(1, padded)."""
    mask: Floats
    """(1, padded) 1 before the padding, 0 in it."""
    centred: Floats
    """(1, padded) target less its mean; 0 in the padding."""
    facts: Floats
    """(2,) mean of the target and of its square."""
    length: int
    """Rows before the padding."""


class Tape(NamedTuple):
    """Scratch for one program's live nodes, see `atoll_core.expression.kernels.tape`."""

    code: Ints
    left: Ints
    right: Ints
    constants: Floats
    wanted: Booleans
    """Nodes that are to be evaluated."""
    depends: Booleans
    """Nodes that depend on a constant that is being fitted."""
    origin: Ints
    """Index in the list that each live node came from."""
    live: Ints
    """(L,) index on the tape of each live node of the list; of dead ones anything."""
    bits: Hashes
    """Live nodes of the list, 64 to a word."""


class Work(NamedTuple):
    """Scratch of the fit for rows of one length: values, adjoints and normal equations."""

    values: Floats
    """(nodes, padded rows)."""
    adjoints: Floats
    """(nodes + 1, LANES); the last row is scratch."""
    basis: Floats
    """(MOST_TERMS, padded rows) the terms, centred and made orthogonal one after the other."""
    columns: Floats
    """(MOST_FITTED, padded rows) columns of the Jacobian."""
    residual: Floats
    """(1, padded rows) target less output; 0 in the padding."""
    matrix: Floats
    damped: Floats
    gradient: Floats
    step: Floats
    means: Floats
    """(MOST_TERMS,) means of the terms."""
    inverse: Floats
    """(MOST_TERMS,) one over the squared length of each row of `basis`; 0 where the term cannot be used."""
    ratio: Floats
    """(MOST_TERMS, MOST_TERMS) how much of each earlier row of `basis` was in a term."""
    terms: Ints
    """Tape indices of the top-level terms; `number` of them."""
    number: Ints
    fitted: Ints
    """Tape indices of the constants that are fitted."""
    kept: Floats
    kept_scale: Floats
    trial: Floats
    settled: Booleans
    """(1,) whether further steps of the last fit would be of no use."""
    functions: int
    """Address of the compiled functions, see `atoll_core.expression.kernels.functions`."""
    held: Booleans
    """(nodes,) constants on the tape that are not fitted."""


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
    due: Booleans
    """(2,) whether a trainer is to be renewed now, and whether the best predictor has changed."""


class Coevolving(NamedTuple):
    """Whether and how predictors coevolve."""

    enabled: int
    effort: float
    renewal: int
    relative: int = 0
    """1: predicted and exact loss are compared by their ratio, 0: by their difference."""


class Book(NamedTuple):
    """Programs that improve a front, as fitted to all rows: (K,) or (K, N) each, see `Tape`."""

    size: Ints
    code: Ints
    left: Ints
    right: Ints
    constants: Floats
    number: Ints
    """Number of terms; 0 when the program is taken as it stands."""
    terms: Ints
    """(K, MOST_TERMS) nodes."""
    scale: Floats
    """(K, 1 + MOST_TERMS) b, a_1, ..."""
    loss: Floats
    variants: Floats
    """(K, 4) loss with the coefficients as they are; without b; with simple ones; with simple ones and without b."""


class Scratch(NamedTuple):
    """Everything a generation needs besides the island's own state."""

    order: Ints
    settled: Booleans
    """(P,) of the island under way: no further step would change the individual's constants."""
    children: Lists
    child_loss: Floats
    child_settled: Booleans
    signature: Ints
    """(P + 2, L) signatures of the population, while generations advance, and of the two children."""
    live: Hashes
    """(P + 2, words) live nodes of each of them, 64 to a word."""
    signed: Ints
    """(2,) row of `signature` that belongs to each child."""
    apart: Ints
    """(4,) distances by signature of child 0, then of child 1, from both parents."""
    tape: Tape
    canonical: Tape
    near: Work
    """For rows of a predictor's length."""
    work: Work
    """For all rows."""
    result: Floats
    spare: Rows
    """Rows for one predictor at a time."""
    predictor_children: Ints
    best_of_size: Ints
    taken: Ints
    hashes: Hashes
    book: Book


MOST_FITTED = 12
"""Constants inside terms that are fitted at most in one program."""

MOST_TERMS = 4
"""Top-level terms with a coefficient of their own, at most."""


MOST_REQUIRED = 62
"""Variables of higher index are required of what enters a front alone: an integer has no more bits."""


def empty_lists(population: int, nodes: int) -> Lists:
    """Return lists of `population` individuals with `nodes` nodes each, all zero, unscaled."""
    shape = (population, nodes)
    scale = np.zeros((population, 1 + MOST_TERMS))
    scale[:, 1] = 1.0
    return Lists(np.zeros(shape, np.int8), np.zeros(shape, np.int16), np.zeros(shape, np.int16), np.zeros(shape), scale)


def empty_tape(nodes: int) -> Tape:
    """Return scratch for a tape of at most `nodes` nodes, all wanted."""
    ints = [np.zeros(nodes, np.int64) for _ in range(5)]
    wanted, depends = np.ones(nodes, np.bool_), np.zeros(nodes, np.bool_)
    bits = np.zeros(-(-nodes // 64), np.uint64)
    return Tape(ints[0], ints[1], ints[2], np.zeros(nodes), wanted, depends, ints[3], ints[4], bits)


def empty_work(nodes: int, rows: int) -> Work:
    """Return scratch to fit programs of at most `nodes` nodes on at most `rows` rows."""
    length = padded(rows)
    return Work(
        values=np.zeros((nodes, length)),
        adjoints=np.zeros((nodes + 1, LANES)),
        basis=np.zeros((MOST_TERMS, length)),
        columns=np.zeros((MOST_FITTED, length)),
        residual=np.zeros((1, length)),
        matrix=np.zeros((MOST_FITTED, MOST_FITTED)),
        damped=np.zeros((MOST_FITTED, MOST_FITTED)),
        gradient=np.zeros(MOST_FITTED),
        step=np.zeros(MOST_FITTED),
        means=np.zeros(MOST_TERMS),
        inverse=np.zeros(MOST_TERMS),
        ratio=np.zeros((MOST_TERMS, MOST_TERMS)),
        terms=np.zeros(MOST_TERMS + 2, np.int64),
        number=np.zeros(1, np.int64),
        fitted=np.zeros(MOST_FITTED, np.int64),
        kept=np.zeros(MOST_FITTED),
        kept_scale=np.zeros(1 + MOST_TERMS),
        trial=np.zeros(2),
        settled=np.zeros(1, np.bool_),
        functions=functions_address(),
        held=np.zeros(nodes, np.bool_),
    )


def empty_scratch(population: int, nodes: int, variables: int, sample: int, rows: int) -> Scratch:
    """Return scratch for an island: `sample` rows in a predictor, `rows` in all."""
    space = nodes + 4 + 3 * MOST_TERMS
    return Scratch(
        order=np.zeros(population, np.int64),
        settled=np.zeros(population, np.bool_),
        children=empty_lists(2, nodes),
        child_loss=np.zeros(2),
        child_settled=np.zeros(2, np.bool_),
        signature=np.zeros((population + 2, nodes), np.int64),
        live=np.zeros((population + 2, -(-nodes // 64)), np.uint64),
        signed=np.zeros(2, np.int64),
        apart=np.zeros(4, np.int64),
        tape=empty_tape(space),
        canonical=empty_tape(space),
        near=empty_work(space, sample),
        work=empty_work(space, rows),
        result=np.zeros(2),
        spare=empty_rows(variables, sample, 0),
        predictor_children=np.zeros((2, sample), np.int64),
        best_of_size=np.zeros(space, np.int64),
        taken=np.zeros(space, np.int64),
        hashes=np.zeros(population, np.uint64),
        book=empty_book(space, space),
    )


def empty_book(programs: int, nodes: int) -> Book:
    """Return room for `programs` programs of at most `nodes` nodes each."""
    code, left, right = (np.zeros((programs, nodes), np.int64) for _ in range(3))
    return Book(
        np.zeros(programs, np.int64), code, left, right, np.zeros((programs, nodes)), np.zeros(programs, np.int64),
        np.zeros((programs, MOST_TERMS), np.int64), np.zeros((programs, 1 + MOST_TERMS)), np.zeros(programs),
        np.zeros((programs, 4)),
    )  # fmt: skip


def empty_rows(variables: int, length: int, waves: int) -> Rows:
    """Return `length` rows to be filled; `waves` is 2 for each variable whose sine and cosine are kept, else 0."""
    wide = padded(length)
    mask = np.zeros((1, wide))
    mask[0, :length] = 1.0
    one = (1, wide)
    return Rows(
        np.zeros((variables, wide)), np.zeros((waves, wide)), np.zeros(one), mask, np.zeros(one), np.zeros(2), length
    )
