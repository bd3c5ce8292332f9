"""Several programs on one tape, and back."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from atoll_coordinator.model.shooting.kernels.rates import rates
from atoll_coordinator.model.shooting.system import system_of, variable_program
from atoll_core.expression.operators import CONSTANT, VARIABLE
from atoll_core.expression.program import constant_places
from atoll_core.expression.text.parsing import from_infix
from tests.oracles.evaluate import evaluate

NAMES = ("x", "y", "u")
TEXTS = ("3*x - 2*x*y - x**2", "sin(u) + 0.25*y", "x/(1.5 + u*u)", "u", "2.5", "-y", "exp(0.1*x) - 7.0")


def parsed(*texts):
    return [from_infix(text, NAMES) for text in texts]


def values(system, point):
    rate, scratch = np.zeros((1, len(system.outputs))), np.zeros(len(system.code))
    rates(system.tape, np.asarray(point, dtype=np.float64), scratch, 0, rate)
    return rate[0].tolist()


@pytest.mark.slow
@settings(max_examples=50, deadline=None)
@given(texts=st.lists(st.sampled_from(TEXTS), min_size=1, max_size=4), order=st.permutations(NAMES))
def test_the_tape_has_the_values_of_the_programs_wherever_the_variables_stand(texts, order):
    point = {"x": 0.7, "y": -1.2, "u": 0.4}
    system = system_of(parsed(*texts), NAMES, order)
    expected = [evaluate(program, [point[name] for name in NAMES]) for program in parsed(*texts)]
    assert values(system, [point[name] for name in order]) == pytest.approx(expected, rel=1e-14)


def test_constants_are_numbered_by_equation_and_node():
    programs = parsed(*TEXTS)
    system = system_of(programs, NAMES, NAMES)
    counts = [len(constant_places(program)) for program in programs]
    assert system.owners.tolist() == [index for index, count in enumerate(counts) for _ in range(count)]
    assert system.values.tolist() == [
        value for program in programs for value in program.constants[constant_places(program)].tolist()
    ]
    assert (system.code[system.places] == CONSTANT).all()
    assert system.parameters[system.places].tolist() == list(range(sum(counts)))
    assert (np.delete(system.parameters, system.places) == -1).all()


def test_fixed_constants_are_no_parameters_and_stay():
    programs = parsed("3*x - 2*y", "4*y")
    held = [constant_places(programs[0]), ()]
    system = system_of(programs, NAMES, NAMES, held)
    assert (system.values.tolist(), system.owners.tolist()) == ([4.0], [1])
    changed = system.with_values(np.array([9.0])).programs
    assert changed[0] == programs[0]
    assert values(system_of(changed, NAMES, NAMES), [1.0, 1.0, 0.0]) == [1.0, 9.0]


def test_a_system_whose_constants_are_fixed_afterwards_is_the_one_of_programs_that_have_them_fixed():
    programs = parsed(*TEXTS)
    built = system_of(programs, NAMES, NAMES).with_fixed_constants()
    expected = system_of(programs, NAMES, NAMES, [constant_places(program) for program in programs])
    assert [array.tobytes() for array in built.tape] == [array.tobytes() for array in expected.tape]
    assert (built.owners.tolist(), built.places.tolist()) == (expected.owners.tolist(), expected.places.tolist())


def test_other_values_make_another_system_and_leave_the_first():
    programs = parsed("3*x - 2*y", "4*y")
    system = system_of(programs, NAMES, NAMES)
    other = system.with_values(system.values + 1.0)
    assert system.values.tolist() == [3.0, 2.0, 4.0]
    assert other.values.tolist() == [4.0, 3.0, 5.0]
    assert values(other, [1.0, 1.0, 0.0]) == [1.0, 5.0]


def test_a_system_gives_back_its_programs():
    programs = parsed(*TEXTS)
    assert system_of(programs, NAMES, NAMES).programs == tuple(programs)


def test_the_program_of_a_variable_is_that_variable():
    program = variable_program(2)
    assert program.operators.tolist() == [VARIABLE]
    assert evaluate(program, [1.0, 2.0, 5.0]) == 5.0
