"""Programs on their way to a front, kept to what an equation must keep to: bounds on constants, required variables.

The population does not know of either; what would enter the front is fitted once more within the bounds (ADR 0050).
"""

from collections.abc import Callable

import numpy as np

from atoll_core.expression.program import Program, constant_places
from atoll_core.expression.restrictions import EquationBounds, Restrictions
from atoll_core.expression.writing.shortest import collected
from atoll_island_worker.evolution.formula import from_program, from_tape, onto_tape, to_program
from atoll_island_worker.evolution.structures import Scratch

Refit = Callable[[int], None]
"""Fits the constants of the program of so many nodes on the canonical tape, but for those that are held."""


def restrained(program: Program, restrictions: Restrictions, scratch: Scratch, refit: Refit) -> Program | None:
    """Return `program` fitted within its bounds, which `refit` has measured last; None when it may not stand."""
    if restrictions.are_kept(program):
        return program
    admitted = restrictions.admitted(program)
    if admitted is None or restrictions.bounds is None or len(admitted) > len(scratch.canonical.code):
        return None
    fitted = _fitted(restrictions.bounds.clipped(admitted), restrictions.bounds, scratch, refit)
    if not np.any(fitted.constants[constant_places(fitted)] == 0.0):
        return fitted
    shorter = restrictions.admitted(collected(fitted))  # without the terms whose coefficients came to be zero
    if shorter is None:
        return None
    return _fitted(restrictions.bounds.clipped(shorter), restrictions.bounds, scratch, refit)


def _fitted(program: Program, bounds: EquationBounds, scratch: Scratch, refit: Refit) -> Program:
    """Return a program that was laid out with its constants fitted; those that reach a bound stay there.

    In each round one constant more is held at least, so that there are no more rounds than constants.
    """
    ranges, places = bounds.ranges(program), constant_places(program)
    assert ranges is not None
    held, tape = scratch.work.held, scratch.canonical
    size = onto_tape(from_program(program), tape)
    while True:
        values = tape.constants[places]
        held[:size] = False
        held[places] = (values <= ranges[0]) | (values >= ranges[1])
        refit(size)
        clipped = np.clip(tape.constants[places], *ranges)
        is_within = np.array_equal(clipped, tape.constants[places])
        tape.constants[places] = clipped
        if is_within:
            held[:size] = False
            return to_program(from_tape(tape, size))
