"""Tapes and canonical programs of lists, against the definitions and against the simplification of programs."""

import numpy as np
import pytest
from hypothesis import assume, given, settings

from atoll_core.expression.operators import ADD, ARITY, DIVIDE, MULTIPLY, SQUARE, SUBTRACT, VARIABLE
from atoll_core.expression.program import check_program_bytes
from atoll_core.expression.simplification import complexity, simplify_program
from atoll_island_worker.evolution.kernels.tape import canonical_tape, compile_tape, mark_live, sign
from atoll_island_worker.evolution.structures import empty_tape, empty_work
from tests.oracles import variation
from tests.oracles.programs import program_of
from tests.oracles.tapes import SPACE, list_of, live_nodes, node_values, program_on, tape_of
from tests.property.programs import NAMES, ROWS, programs

X, Y = (VARIABLE, 0), (VARIABLE, 1)
QUICK = settings(max_examples=200, deadline=None, derandomize=True, database=None)


def canonical(program):
    source, count = tape_of(program)
    tape = empty_tape(SPACE)
    return program_on(tape, canonical_tape(source, count, empty_work(SPACE, 1), tape))


def compiled(program):
    lists, tape = list_of(program), empty_tape(SPACE)
    return tape, compile_tape(lists, 0, tape)


def assert_same_bits(one, other, row):
    inputs = np.array(row)[:, None]
    actual, expected = (node_values(program, inputs)[-1] for program in (one, other))
    np.testing.assert_array_equal(actual, expected)
    assert np.signbit(actual) == np.signbit(expected) or np.isnan(actual)


def marked(lists, p, words):
    """Return the nodes that `mark_live` marks in words that are not empty before."""
    bits = np.full(words, 0xDEADBEEF, np.uint64)
    mark_live(lists, p, bits)
    return [64 * word + b for word in range(words) for b in range(64) if int(bits[word]) >> b & 1]


@pytest.mark.slow
@QUICK
@given(programs())
def test_live_nodes_are_those_that_the_output_depends_on(program):
    assert marked(list_of(program), 0, 1) == live_nodes(program)


def test_the_highest_bit_of_a_word_is_a_node_like_any_other():
    """Node 63 is the output in one list, and an argument of node 64 in the other list."""
    nodes = [X] * 63 + [(SQUARE, 62)]
    assert marked(list_of(program_of(nodes)), 0, 1) == [62, 63]
    assert marked(list_of(program_of([*nodes, (ADD, 63, 0)])), 0, 2) == [0, 62, 63, 64]


@pytest.mark.slow
@QUICK
@given(programs())
def test_a_signature_says_of_each_live_node_its_operator_and_arguments(program):
    lists, signature = list_of(program), np.full((3, len(program)), -7)
    sign(lists, 0, np.zeros(1, np.uint64), signature, 1)
    assert (signature[[0, 2]] == -7).all()
    live = set(live_nodes(program))
    meaning = {i: variation.meaning(node) for i, node in enumerate(variation.nodes_of(lists, 0))}
    for i in range(len(program)):
        assert (signature[1, i] == 0) == (i not in live)
        for j in live & set(range(i)) if i in live else ():
            assert (signature[1, i] == signature[1, j]) == (meaning[i] == meaning[j])


@pytest.mark.slow
@QUICK
@given(programs(), ROWS)
def test_a_tape_holds_the_live_nodes_in_order_and_has_their_values(program, row):
    tape, count = compiled(program)
    assert tape.origin[:count].tolist() == live_nodes(program)
    assert tape.live[tape.origin[:count]].tolist() == list(range(count))
    on_tape = program_on(tape, count)
    check_program_bytes(on_tape.to_bytes(), len(NAMES))
    inputs = np.array(row)[:, None]
    np.testing.assert_array_equal(node_values(on_tape, inputs), node_values(program, inputs)[live_nodes(program)])


@pytest.mark.slow
@QUICK
@given(programs(), ROWS)
def test_the_canonical_tape_keeps_every_bit_and_has_only_live_and_different_nodes(program, row):
    simple = canonical(program)
    check_program_bytes(simple.to_bytes(), len(NAMES))
    assert live_nodes(simple) == list(range(len(simple)))
    assert_same_bits(simple, program, row)


@pytest.mark.slow
@QUICK
@given(programs())
def test_the_canonical_tape_has_the_complexity_of_the_program(program):
    """Programs with constant parts that are not finite are left out: only the tape replaces such parts by values."""
    values = node_values(program, np.zeros((len(NAMES), 1)))[:, 0]
    depends_on_input = np.zeros(len(program), bool)
    for node, code in enumerate(program.operators):
        parts = (program.left[node], program.right[node])[: ARITY[code]]
        depends_on_input[node] = code == VARIABLE or depends_on_input[list(parts)].any()
    assume(np.isfinite(values[~depends_on_input]).all())
    assert len(canonical(program)) == complexity(program)


@pytest.mark.slow
@QUICK
@given(programs(), ROWS)
def test_what_is_canonical_stays_so(program, row):
    simple = canonical(program)
    assert canonical(simple) == simple
    assert_same_bits(simplify_program(simple), program, row)


def test_sums_and_products_are_the_same_in_either_order_but_differences_are_not():
    both = [X, Y, (ADD, 0, 1), (ADD, 1, 0), (MULTIPLY, 2, 3)]
    assert len(canonical(program_of(both))) == 4
    both = [X, Y, (SUBTRACT, 0, 1), (SUBTRACT, 1, 0), (MULTIPLY, 2, 3)]
    assert len(canonical(program_of(both))) == 5


def test_a_square_is_a_product_with_itself():
    assert len(canonical(program_of([X, (SQUARE, 0), (MULTIPLY, 0, 0), (ADD, 1, 2)]))) == 3


def test_zeros_of_different_sign_are_different_constants():
    nodes = [0.0, -0.0, X, (DIVIDE, 2, 0), (DIVIDE, 2, 1), (ADD, 3, 4)]
    assert len(canonical(program_of(nodes))) == 6


def test_constants_are_folded_through_and_through():
    nodes = [2.0, 3.0, (ADD, 0, 1), (MULTIPLY, 2, 2), X, (SUBTRACT, 4, 3)]
    tape = canonical(program_of(nodes))
    assert len(tape) == 3
    assert 25.0 in tape.constants
