"""How a first population takes in the guesses: each becomes one individual of every island, its constants fitted.

The constants of a guess are starting values. The first island begins from them as they are, the others from values
around them, so that an archipelago begins with as many attempts to fit a guess as it has islands (ADR 0019).
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from atoll_core.expression.operation_list import PlacedNode, placed_text
from atoll_core.expression.operators import ARITY, CONSTANT
from atoll_core.search.seeding import Stream, stream_key
from atoll_island_worker.evolution.kernels.generation import OFFSPRING, measure_all
from atoll_island_worker.evolution.setup import IslandSetup
from atoll_island_worker.evolution.structures import Ints, Lists, Rows

GUESS_STEPS: Final = 25
"""Levenberg-Marquardt steps at most by which the constants of a guess are fitted before the first generation."""

OCTAVES: Final = 3
"""A varied constant is at least 2^-OCTAVES and less than 2^OCTAVES times the one given."""

Guess = Sequence[PlacedNode]


def begin_with_guesses(lists: Lists, setup: IslandSetup, rows: Rows, counters: Ints) -> None:
    """Write the guesses for this equation over the first individuals, one each, and fit their constants to `rows`.

    The fit is counted as that of offspring. Where nothing is fitted, all islands take the guesses as they are. Pure but
    for `lists`, scratch and `counters`.
    """
    guesses = parse_guesses(setup)
    if not guesses:
        return
    is_fitted = setup.fit.steps > 0
    key = stream_key(setup.config.seed, setup.variable, setup.island, 0, "guesses")
    stream = Stream(key) if is_fitted and setup.island > 0 else None
    for p, guess in enumerate(guesses):
        place(lists, p, guess, stream)
    if is_fitted:
        first = Lists(*(column[: len(guesses)] for column in lists._asdict().values()))
        fitness, options, scratch = np.zeros(len(guesses)), setup.fit._replace(steps=GUESS_STEPS), setup.scratch
        measure_all(first, fitness, rows, options, scratch._replace(near=scratch.work), counters, OFFSPRING)


def parse_guesses(setup: IslandSetup) -> tuple[Guess, ...]:
    """Return the nodes of the guesses for the equation of `setup`.

    Raises:
        UsageError: a guess does not fit its lists; a coordinator refuses such jobs.
    """
    space = setup.space
    operators, inner = space.operators.tolist(), space.nodes - space.terminals
    texts = setup.config.prior.guesses.get(setup.variable, ())
    return tuple(placed_text(text, setup.names, operators, space.terminals, inner) for text in texts)


def place(lists: Lists, p: int, guess: Guess, stream: Stream | None) -> None:
    """Write a guess over individual `p`; constants are varied with `stream`, if there is one.

    Nodes that the guess leaves free, and second arguments of unary operators, stay as they were drawn.
    """
    for node in guess:
        lists.code[p, node.index] = node.code
        lists.left[p, node.index] = node.left
        lists.constants[p, node.index] = node.constant
        if ARITY[node.code] != 1:
            lists.right[p, node.index] = node.right
        if stream is not None and node.code == CONSTANT:
            octave = stream.below(2 * OCTAVES) - OCTAVES
            factor = math.ldexp(1.0 + stream.uniform(), octave)  # nearly log-uniform, without a logarithm
            lists.constants[p, node.index] = node.constant * factor
