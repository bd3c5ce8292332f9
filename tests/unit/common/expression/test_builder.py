"""Programs under construction."""

from atoll_core.expression.builder import ProgramBuilder, operators_in
from atoll_core.expression.operators import ADD, CONSTANT, MULTIPLY, NEGATE, SIN, VARIABLE
from atoll_core.expression.text.infix import to_infix
from tests.oracles.programs import program_of

NAMES = ("x", "y")


def text_of(builder, output):
    return to_infix(builder.program(output), NAMES)


def test_equal_nodes_are_one_and_appended_ones_stay_apart():
    builder = ProgramBuilder()
    assert builder.constant(2.0) == builder.constant(2.0)
    assert builder.append(CONSTANT, value=2.0) != builder.append(CONSTANT, value=2.0)


def test_zeros_of_either_sign_differ():
    builder = ProgramBuilder()
    assert builder.constant(0.0) != builder.constant(-0.0)


def test_an_expression_is_built_of_numbers_variables_and_earlier_nodes():
    builder = ProgramBuilder()
    x = builder.add(VARIABLE, 0)
    assert text_of(builder, builder.build((ADD, x, (MULTIPLY, 0.5, (SIN, (VARIABLE, 1)))))) == "x + 0.5*sin(y)"


def test_a_program_holds_what_its_output_depends_on():
    builder = ProgramBuilder()
    builder.add(VARIABLE, 1)
    output = builder.build((NEGATE, (VARIABLE, 0)))
    builder.constant(3.0)
    assert builder.program(output) == program_of([(VARIABLE, 0), (NEGATE, 0)])


def test_nodes_of_an_expression_may_be_those_of_a_list_that_was_copied():
    builder = ProgramBuilder()
    builder.constant(7.0)
    places = builder.copy(program_of([(VARIABLE, 1), (NEGATE, 0)]).nodes())
    assert text_of(builder, builder.build((MULTIPLY, 1, 0), places)) == "-y**2"


def test_only_operators_of_an_expression_are_listed():
    assert list(operators_in((ADD, 1, (MULTIPLY, 2.0, (VARIABLE, 0))))) == [ADD, MULTIPLY]
