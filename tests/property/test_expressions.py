"""What must hold of every program: encoding, printing and parsing, simplification."""

import contextlib
import itertools
import math
import struct

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from atoll.export.formats import LANGUAGES
from atoll_core.errors import UsageError
from atoll_core.expression.operators import (
    ADD,
    ARITY,
    CONSTANT,
    COS,
    DIVIDE,
    EXP,
    LOG,
    MULTIPLY,
    OPERATORS,
    POW,
    SIN,
    SUBTRACT,
    TANH,
    VARIABLE,
)
from atoll_core.expression.program import Program, check_program_bytes, tree_size
from atoll_core.expression.simplification import complexity, simplify_program
from atoll_core.expression.text.infix import PRINTABLE_SIZE, to_code, to_infix
from atoll_core.expression.text.parsing import from_infix
from tests.oracles.evaluate import evaluate
from tests.property.programs import HOSTILE_NAMES, NAMES, ROWS, programs

NOTATIONS = [language.notation for language in LANGUAGES.values()]
TAME = st.floats(0.5, 2.0)
QUICK = settings(max_examples=150, deadline=None, derandomize=True, database=None)


def bits(value: float) -> bytes:
    """Return the bits of `value`; all NaN are one."""
    return b"nan" if math.isnan(value) else struct.pack("<d", value)


@QUICK
@given(programs(), ROWS)
def test_parsing_what_was_printed_evaluates_to_the_same_bits(program, row):
    assume(tree_size(program) <= PRINTABLE_SIZE)
    text = to_infix(program, NAMES)
    assert bits(evaluate(from_infix(text, NAMES), row)) == bits(evaluate(program, row)), text


@QUICK
@given(programs(), HOSTILE_NAMES)
def test_whatever_variables_are_called_they_are_written_and_read_alike(program, names):
    assume(tree_size(program) <= PRINTABLE_SIZE)
    for digits in (None, 6):
        text = to_infix(program, names, digits=digits)
        assert from_infix(text, names) == from_infix(to_infix(program, NAMES, digits=digits), NAMES), text


@pytest.mark.slow
def test_names_that_begin_like_functions_are_names_beside_each_operator():
    beginnings = [operator.text for operator in OPERATORS if operator.text and operator.text.isalpha()] + [
        "tan",
        "cot",
        "ln",
        "fabs",
    ]
    for first, second, ending in itertools.product(beginnings, beginnings, ("", "x", "_theta", "2")):
        names = (first + ending, second + ending + "_" * (first == second), "x")
        for code in (ADD, SUBTRACT, MULTIPLY, DIVIDE, POW):
            program = Program.of([(VARIABLE, 0, 0, 0.0), (VARIABLE, 1, 0, 0.0), (code, 0, 1, 0.0)])
            assert from_infix(to_infix(program, names), names) == program
            assert all(name in to_code(program, names, notation, {}) for name in names[:2] for notation in NOTATIONS)


@pytest.mark.parametrize("exponent", [2, 3, 63, 64, 65, 66, 100])
def test_a_product_of_many_equal_factors_is_read_as_the_same_product(exponent):
    nodes = [(VARIABLE, 0, 0, 0.0), *((MULTIPLY, place, 0, 0.0) for place in range(exponent - 1))]
    program = Program.of(nodes)
    read = from_infix(to_infix(program, NAMES), NAMES)
    assert POW not in read.operators.tolist()
    row = (1.0 + 1e-7, 0.0, 0.0)
    assert bits(evaluate(read, row)) == bits(evaluate(program, row))


@pytest.mark.slow
@QUICK
@given(programs())
def test_printing_what_was_parsed_gives_the_same_text(program):
    assume(tree_size(program) <= PRINTABLE_SIZE)
    text = to_infix(from_infix(to_infix(program, NAMES), NAMES), NAMES)
    assert to_infix(from_infix(text, NAMES), NAMES) == text


@pytest.mark.slow
@QUICK
@given(programs(), ROWS)
def test_simplifying_keeps_every_bit(program, row):
    simple = simplify_program(program)
    check_program_bytes(simple.to_bytes(), len(NAMES))
    assume(not folded_elementary(program))
    assert bits(evaluate(simple, row)) == bits(evaluate(program, row))


@pytest.mark.slow
@QUICK
@given(programs())
def test_simplifying_twice_changes_nothing_more(program):
    simple = simplify_program(program)
    assert simplify_program(simple) == simple
    assert complexity(program) == complexity(simple) == len(simple) <= len(program)


@pytest.mark.slow
@QUICK
@given(programs())
def test_programs_survive_their_bytes(program):
    assert Program.from_bytes(program.to_bytes(), len(NAMES)) == program


@pytest.mark.slow
@settings(QUICK, suppress_health_check=[HealthCheck.filter_too_much])
@given(programs(largest=10, constants=TAME), st.tuples(TAME, TAME, TAME))
def test_display_has_the_value_up_to_rounding(program, row):
    exact = evaluate(program, row)
    assume(is_tame(program, row))
    text = to_infix(program, NAMES, digits=17)
    assert math.isclose(evaluate(from_infix(text, NAMES), row), exact, rel_tol=1e-9, abs_tol=1e-9), text


@QUICK
@given(st.text(alphabet="xyθ0123456789.+-*/() sincoexplgjq^,", max_size=30))
def test_any_text_is_an_expression_or_refused(text):
    with contextlib.suppress(UsageError):
        check_program_bytes(from_infix(text, NAMES).to_bytes(), len(NAMES))


def folded_elementary(program: Program) -> bool:
    """Say whether constants meet a function whose last bit is the kernels' own, not the C library's."""
    constant: list[bool] = []
    for code, left, right in zip(program.operators.tolist(), program.left, program.right, strict=True):
        operands = [constant[left], constant[right]][: ARITY[code]] if ARITY[code] else []
        constant.append(code == CONSTANT or (bool(operands) and all(operands)))
        if constant[-1] and code in (SIN, COS, EXP, LOG, TANH, POW):
            return True
    return False


def is_tame(program: Program, row: tuple[float, ...]) -> bool:
    """Say whether no part of `program` is so large or so small that rounding is magnified."""
    columns = (program.operators, program.left, program.right, program.constants)
    parts = [Program(*(column[:count] for column in columns)) for count in range(1, len(program) + 1)]
    return all(1e-2 < abs(evaluate(part, row)) < 1e2 for part in parts)
