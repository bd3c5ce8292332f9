"""Coefficients written into a program, and programs without one of its parts."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from atoll_core.expression.operators import ARITY, SUBTRACT, VARIABLE
from atoll_core.expression.program import check_program_bytes
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from atoll_island_worker.evolution.front import (
    from_program,
    from_tape,
    onto_tape,
    reductions,
    to_program,
)
from atoll_island_worker.evolution.kernels.offers import SIMPLE_COEFFICIENTS, WITHOUT_SHIFT, write_variant
from atoll_island_worker.evolution.structures import MOST_TERMS, empty_scratch, empty_tape
from tests.oracles.programs import program_of
from tests.oracles.tapes import node_values
from tests.property.programs import NAMES, programs

QUICK = settings(max_examples=150, deadline=None, derandomize=True, database=None)
X, Y = (VARIABLE, 0), (VARIABLE, 1)
INPUTS = np.random.default_rng(0).uniform(0.5, 2.0, (len(NAMES), 5))
COEFFICIENTS = st.lists(st.sampled_from([0.0, 1.0, -1.0, 2.5, -0.25]), min_size=4, max_size=4)


def written(program, terms, coefficients, shift, variant=0):
    """Return the program b + a_1 t_1 + ... that `write_variant` writes for these terms of `program`."""
    nodes = len(program)
    scratch = empty_scratch(2, nodes + 3 * MOST_TERMS + 2, len(NAMES), 1, 1)
    book = scratch.book
    book.size[0], book.number[0] = nodes, len(terms)
    book.code[0, :nodes], book.constants[0, :nodes] = program.operators, program.constants
    book.left[0, :nodes], book.right[0, :nodes] = program.left, program.right
    book.terms[0, : len(terms)] = terms
    book.scale[0, : 1 + len(terms)] = [shift, *coefficients[: len(terms)]]
    return to_program(from_tape(scratch.canonical, write_variant(book, 0, variant, scratch)))


@QUICK
@given(programs())
def test_a_formula_goes_to_a_program_and_a_tape_and_back(program):
    formula, tape = from_program(program), empty_tape(len(program))
    assert to_program(formula) == program
    assert from_tape(tape, onto_tape(formula, tape)) == formula


@pytest.mark.slow
@QUICK
@given(programs(constants=st.floats(-5.0, 5.0)), COEFFICIENTS, st.sampled_from([0.0, 1.5, -2.0]), st.data())
def test_a_combination_is_worth_what_it_says(program, coefficients, shift, data):
    node = st.integers(0, len(program) - 1)
    terms = data.draw(st.lists(node, max_size=4, unique=True))
    combined = written(program, terms, coefficients, shift)
    check_program_bytes(combined.to_bytes(), len(NAMES))
    values = node_values(program, INPUTS)
    expected = np.full(INPUTS.shape[1], shift)
    for term, a in zip(terms, coefficients, strict=False):
        if a != 0.0:
            expected = expected + a * values[term]
    expected = np.where(np.isfinite(expected), expected, np.nan)
    combined_values = node_values(combined, INPUTS)[-1]
    np.testing.assert_allclose(
        np.where(np.isfinite(combined_values), combined_values, np.nan), expected, rtol=1e-9, atol=1e-12
    )


@pytest.mark.parametrize(
    ("coefficients", "shift", "expected"),
    [
        ([1.0, 1.0], 0.0, "x + y"),
        ([1.0, -1.0], 0.0, "x - y"),
        ([-1.0, 1.0], 0.0, "y - x"),
        ([-2.0, 3.0], 0.0, "3.0*y - 2.0*x"),
        ([0.0, 3.0], 0.0, "3.0*y"),
        ([-1.0, 0.0], 0.0, "-x"),
        ([-1.0, -2.0], 0.0, "-x - 2.0*y"),
        ([2.0, 0.0], 1.5, "2.0*x + 1.5"),
        ([0.0, 0.0], 1.5, "1.5"),
        ([0.0, 0.0], 0.0, "0.0"),
    ],
)
def test_combinations_read_as_a_person_would_write_them(coefficients, shift, expected):
    combined = written(program_of([X, Y]), [0, 1], coefficients, shift)
    assert to_infix(from_infix(expected, ("x", "y")), ("x", "y")) == to_infix(combined, ("x", "y"))


@pytest.mark.parametrize(
    ("variant", "expected"),
    [
        (0, "1.00001*x - 0.99999*y + 0.5"),
        (WITHOUT_SHIFT, "1.00001*x - 0.99999*y"),
        (SIMPLE_COEFFICIENTS, "x - y + 0.5"),
        (WITHOUT_SHIFT | SIMPLE_COEFFICIENTS, "x - y"),
        (-1, "y"),
    ],
)
def test_variants_leave_out_the_shift_or_use_exact_coefficients_or_neither_or_no_coefficients(variant, expected):
    combined = written(program_of([X, Y]), [0, 1], [1.00001, -0.99999], 0.5, variant)
    assert to_infix(from_infix(expected, ("x", "y")), ("x", "y")) == to_infix(combined, ("x", "y"))


@pytest.mark.slow
@QUICK
@given(programs())
def test_reductions_are_sound_and_every_operator_gives_way_to_each_argument_and_to_a_constant(program):
    formula = from_program(program)
    formulas = list(reductions(formula))
    expected = 0
    for node in formula:
        expected += 0 if ARITY[node.code] == 0 else 2 if ARITY[node.code] == 1 or node.left == node.right else 3
        expected += node.code == SUBTRACT
    assert len(formulas) == expected
    for reduced in formulas:
        check_program_bytes(to_program(reduced).to_bytes(), len(NAMES))
