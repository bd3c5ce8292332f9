"""The arrays that kernels work on, grouped.

Letters: P population, L list length, T terminals, V variables, K predictors (in `Book`: programs), R rows. The groups
are NamedTuples of arrays, because numba can pass them as arguments. The functions ``empty_...`` set the shapes, and
the kernels do not check them.
"""

import math
from typing import Any, Final, NamedTuple

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
    """Operation lists of P individuals, dead nodes included. T terminals come first; the last node is the output."""

    code: Bytes
    """(P, L) operator codes."""
    left: Shorts
    """(P, L) earlier node, or the variable's index at VARIABLE nodes."""
    right: Shorts
    """(P, L) earlier node; unary operators have one, too, which is varied but not used."""
    constants: Floats
    """(P, L) value at CONSTANT nodes; not used at other nodes."""
    scale: Floats
    """(P, 1 + MOST_TERMS) b, a_1, ...: the output is b + a_1 t_1 + ... for the list's top-level terms t_j."""


class Space(NamedTuple):
    """The space from which lists are drawn: `terminals` T, `nodes` L, `variables` V, probabilities of variation."""

    terminals: int
    nodes: int
    variables: int
    operators: Ints
    """Codes of the allowed operators."""
    scales: Floats
    """Scales of columns and target for drawing constants, powers of two; empty: constants are drawn from [-10, 10]."""
    crossover: float
    mutation: float
    steps: int = 0
    """How the mutation of a constant moves it, see `variation`; 0: by relative steps, 1: by log-uniform steps."""
    moves: float = 0.5
    """Share of mutated constants that are moved; the others are drawn again."""


class Fit(NamedTuple):
    """How constants are fitted."""

    steps: int
    """Levenberg-Marquardt steps for the constants inside terms; 0: none."""
    terms: int
    """Largest number of top-level terms with a fitted coefficient; 0: no coefficients are fitted."""
    least: int
    """Number of inner constants that may be fitted even if there are few rows."""
    loss: int
    """0: mean absolute error, 1: mean squared error."""
    gate: float
    """Steps are taken for a child only if its loss is at most this share of the loss of its worse parent."""
    required: int = 0
    """Bits of the required variables below `MOST_REQUIRED`; the loss of individuals without them is infinity."""


class Rows(NamedTuple):
    """Rows on which individuals are measured; their number is padded to a multiple of LANES by repeating the last."""

    inputs: Floats
    """(V, padded) input variables."""
    waves: Floats
    """(2 V, padded) sine and cosine of each input; (0, padded) if they are not stored but computed when needed."""
    target: Floats
    """(1, padded) target."""
    mask: Floats
    """(1, padded) 1 for rows, 0 in the padding."""
    centred: Floats
    """(1, padded) target minus its mean; 0 in the padding."""
    facts: Floats
    """(2,) mean of the target, mean square of the target."""
    length: int
    """Number of rows without the padding."""


class Tape(NamedTuple):
    """Scratch for the live nodes of one program, arrays (nodes,), see `atoll_core.expression.kernels.tape`."""

    code: Ints
    left: Ints
    right: Ints
    constants: Floats
    wanted: Booleans
    """Nodes that are to be evaluated."""
    depends: Booleans
    """Nodes that depend on a fitted constant."""
    origin: Ints
    """Index in the list of each node on the tape."""
    live: Ints
    """Index on the tape of each live node of the list; undefined for dead nodes."""
    bits: Hashes
    """(words,) bits of the live nodes of the list, 64 nodes per word."""


class Work(NamedTuple):
    """Scratch of the fit for rows of one length: values, adjoints and normal equations."""

    values: Floats
    """(nodes, padded rows) values of the nodes."""
    adjoints: Floats
    """(nodes + 1, LANES) adjoints of the nodes in one block; the last row is scratch."""
    basis: Floats
    """(MOST_TERMS, padded rows) the terms, centred and orthogonalised in their order."""
    columns: Floats
    """(MOST_FITTED, padded rows) columns of the Jacobian."""
    residual: Floats
    """(1, padded rows) target minus output; 0 in the padding."""
    matrix: Floats
    """(MOST_FITTED, MOST_FITTED) products of the Jacobian's columns, lower triangle."""
    damped: Floats
    """(MOST_FITTED, MOST_FITTED) Cholesky factor of the damped matrix; the diagonal holds inverses."""
    gradient: Floats
    """(MOST_FITTED,) half the gradient of the sum of squared residuals."""
    step: Floats
    """(MOST_FITTED,) step of the fitted constants."""
    means: Floats
    """(MOST_TERMS,) means of the terms."""
    inverse: Floats
    """(MOST_TERMS,) inverse of the squared length of each row of `basis`; 0 if the term cannot be used."""
    ratio: Floats
    """(MOST_TERMS, MOST_TERMS) coefficients of the earlier rows of `basis` in each term."""
    terms: Ints
    """Tape indices of the top-level terms; `number` (1,) is how many there are."""
    number: Ints
    fitted: Ints
    """(MOST_FITTED,) tape indices of the fitted constants."""
    kept: Floats
    """(MOST_FITTED,) fitted constants before the step."""
    kept_scale: Floats
    """(1 + MOST_TERMS,) scale of the best trial so far."""
    trial: Floats
    """(2,) mean absolute and mean squared error of the last trial."""
    settled: Booleans
    """(1,) whether further steps of the last fit would not improve it."""
    functions: int
    """Address of the compiled functions, see `atoll_core.expression.kernels.functions`."""
    held: Booleans
    """(nodes,) constants on the tape that must not be fitted."""


class Coevolution(NamedTuple):
    """Fitness predictors and their trainers (paper, section 2.3)."""

    predictors: Ints
    """(K, sample) row indices of each predictor; an index may occur several times."""
    quality: Floats
    """(K,) mean absolute difference of predicted and exact loss over the trainers; lower is better."""
    trainers: Lists
    exact: Floats
    """(trainers,) exact loss."""
    losses: Floats
    """(trainers, R) loss at every row; not part of a checkpoint, because it can be computed from the trainers."""
    born: Ints
    """(trainers,) predictor generation in which each became a trainer."""
    best: Ints
    """(1,) index of the best predictor, whose rows measure the solutions."""
    clock: Ints
    """(1,) number of predictor generations so far."""
    due: Booleans
    """(2,) whether a trainer must be renewed now, and whether the best predictor has changed."""


class Coevolving(NamedTuple):
    """Whether and how predictors coevolve; `effort` and `renewal` as in `atoll_core.config.PredictorConfig`."""

    enabled: int
    effort: float
    renewal: int
    relative: int = 0
    """How predicted and exact loss are compared; 0: by their difference, 1: by their relative difference."""


class Book(NamedTuple):
    """K programs that improve a front, fitted to all rows; arrays are (K,), or (K, nodes) as in `Tape`."""

    size: Ints
    code: Ints
    left: Ints
    right: Ints
    constants: Floats
    number: Ints
    """(K,) number of terms; 0 if no coefficients were fitted."""
    terms: Ints
    """(K, MOST_TERMS) node of each term."""
    scale: Floats
    """(K, 1 + MOST_TERMS) b, a_1, ..."""
    loss: Floats
    variants: Floats
    """(K, 4) loss with the fitted coefficients; without b; with simple coefficients (exactly 1 or -1 if close to it);
    with simple coefficients and without b."""


class Scratch(NamedTuple):
    """Arrays that a generation needs in addition to the island's own state."""

    order: Ints
    """(P,) random order of the individuals; neighbours are parents together."""
    settled: Booleans
    """(P,) whether further steps would not improve the constants of an individual of this island."""
    children: Lists
    """Lists of two children."""
    child_loss: Floats
    """(2,) losses of the children."""
    child_settled: Booleans
    """(2,) `settled` of the children."""
    signature: Ints
    """(P + 2, L) signatures of the population and of the two children; valid while generations advance."""
    live: Hashes
    """(P + 2, words) bits of the live nodes of each of them, 64 nodes per word."""
    signed: Ints
    """(2,) row of `signature` that belongs to each child."""
    apart: Ints
    """(4,) distances by signature of child 0, then of child 1, from both parents."""
    tape: Tape
    canonical: Tape
    near: Work
    """Scratch for fits on the rows of a predictor."""
    work: Work
    """Scratch for fits on all rows."""
    result: Floats
    """(2,) mean absolute and mean squared error."""
    spare: Rows
    """Rows of one predictor at a time."""
    predictor_children: Ints
    """(2, sample) two predictors."""
    best_of_size: Ints
    """(sizes,) an individual of each size, -1 without one."""
    taken: Ints
    """(sizes,) number of individuals taken of each size."""
    hashes: Hashes
    """(P,) hashes of the individuals' structures."""
    book: Book


MOST_FITTED = 12
"""Largest number of constants inside terms that are fitted in one program."""

MOST_TERMS = 4
"""Largest number of top-level terms with a fitted coefficient."""


MOST_REQUIRED = 62
"""Only required variables below this index are checked in the population, because an integer has no more bits. The
front checks all of them."""


CACHE_LINE: Final = 64
"""Bytes of a cache line; a vector register holds as many."""


def zeros(shape: tuple[int, ...], kind: npt.DTypeLike = np.float64) -> npt.NDArray[Any]:
    """Return zeros that begin at a cache line, for arrays that kernels load into vector registers.

    A vector across two cache lines takes two loads. numpy's arrays begin anywhere.
    """
    kind = np.dtype(kind)
    size = math.prod(shape) * kind.itemsize
    room = np.zeros(size + CACHE_LINE, np.uint8)
    first = -room.__array_interface__["data"][0] % CACHE_LINE
    return room[first : first + size].view(kind).reshape(shape)


def empty_lists(population: int, nodes: int) -> Lists:
    """Return the lists of `population` individuals with `nodes` nodes each, all zero and unscaled."""
    shape = (population, nodes)
    scale = zeros((population, 1 + MOST_TERMS))
    scale[:, 1] = 1.0
    return Lists(zeros(shape, np.int8), zeros(shape, np.int16), zeros(shape, np.int16), zeros(shape), scale)


def empty_tape(nodes: int) -> Tape:
    """Return a tape for at most `nodes` nodes, all marked as wanted."""
    ints = [np.zeros(nodes, np.int64) for _ in range(5)]
    wanted, depends = np.ones(nodes, np.bool_), np.zeros(nodes, np.bool_)
    bits = np.zeros(-(-nodes // 64), np.uint64)
    return Tape(ints[0], ints[1], ints[2], np.zeros(nodes), wanted, depends, ints[3], ints[4], bits)


def empty_work(nodes: int, rows: int) -> Work:
    """Return scratch for fits of programs with at most `nodes` nodes on at most `rows` rows."""
    length = padded(rows)
    return Work(
        values=zeros((nodes, length)),
        adjoints=zeros((nodes + 1, LANES)),
        basis=zeros((MOST_TERMS, length)),
        columns=zeros((MOST_FITTED, length)),
        residual=zeros((1, length)),
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
    """Return scratch for an island; `sample` is the number of rows of a predictor, `rows` the number of all rows."""
    space = nodes + 4 + 3 * MOST_TERMS
    return Scratch(
        order=np.zeros(population, np.int64),
        settled=np.zeros(population, np.bool_),
        children=empty_lists(2, nodes),
        child_loss=np.zeros(2),
        child_settled=np.zeros(2, np.bool_),
        signature=zeros((population + 2, nodes), np.int64),
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
    """Return an empty book for `programs` programs of at most `nodes` nodes each."""
    code, left, right = (np.zeros((programs, nodes), np.int64) for _ in range(3))
    return Book(
        np.zeros(programs, np.int64), code, left, right, np.zeros((programs, nodes)), np.zeros(programs, np.int64),
        np.zeros((programs, MOST_TERMS), np.int64), np.zeros((programs, 1 + MOST_TERMS)), np.zeros(programs),
        np.zeros((programs, 4)),
    )  # fmt: skip


def empty_rows(variables: int, length: int, waves: int) -> Rows:
    """Return `length` empty rows; `waves` is the first dimension of `Rows.waves`: 2 `variables`, or 0."""
    wide = padded(length)
    mask = zeros((1, wide))
    mask[0, :length] = 1.0
    one = (1, wide)
    return Rows(zeros((variables, wide)), zeros((waves, wide)), zeros(one), mask, zeros(one), np.zeros(2), length)
