"""What it takes to write a structure down."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from atoll.expression.program import with_constants
from atoll.expression.text.parsing import from_infix
from atoll_coordinator.model.criteria import TrajectoryMisfit, structure_length
from atoll_coordinator.model.structure.moves.extensions import extensions
from tests.unit.coordinator.model.fitting import parsed


def nats(text):
    return structure_length(from_infix(text, ("x", "y")))


@pytest.mark.parametrize(
    ("plain", "dear"),
    [
        ("x", "sin(x)"),
        ("x*y", "x/y"),
        ("x/y", "exp(x)*y"),
        ("sin(x)", "sin(sin(x))"),
        ("sin(x) + sin(y)", "sin(x + sin(y))"),
        ("cos(x)*sin(y)", "cos(x*sin(y))"),
        ("x*x", "exp(x)"),
        ("x*x", "x**1.5"),
        ("x", "x + y"),
        ("2.0*x", "2.0*x + 3.0"),
        ("x*y + 2.0*x", "x*y + 2.0*x + 2.0*y"),
    ],
)
def test_what_is_rarer_in_equations_of_motion_costs_more(plain, dear):
    assert nats(plain) < nats(dear)


def test_a_function_inside_a_function_costs_more_than_both_apart():
    assert nats("sin(cos(x))") > nats("sin(x)") + nats("cos(x)") - nats("x")
    assert nats("sin(2.0*cos(x) + y)") - nats("2.0*cos(x) + y") > nats("sin(x)") - nats("x")


def test_what_is_no_transcendental_function_may_stand_anywhere():
    assert nats("sin(x*x)") - nats("x*x") == pytest.approx(nats("sin(x)") - nats("x"))
    assert nats("sin(-x)") == nats("sin(x)")


def test_a_square_costs_about_as_much_as_the_product():
    assert abs(nats("x**2") - nats("x*x")) <= 1.5


def test_using_a_part_again_is_cheaper_than_writing_it_twice():
    shared = nats("(x + 2.0*y)*(x + 2.0*y)")
    assert shared < nats("(x + 2.0*y)*(x + 3.0*y)")
    assert shared > nats("x + 2.0*y")


@settings(max_examples=30, deadline=None)
@given(value=st.floats(-1e6, 1e6))
def test_the_values_of_constants_do_not_count(value):
    program = parsed("3.5*x + sin(2.5*y)")
    places = [index for index, code in enumerate(program.operators.tolist()) if code == 1]
    assert structure_length(with_constants(program, dict.fromkeys(places, value))) == structure_length(program)


@pytest.mark.parametrize("text", ["x", "3.0*x - 2.0*x*y", "sin(x)/y"])
def test_every_extension_that_is_one_costs_more(text):
    program = parsed(text)
    for extended in extensions(program, [1.0, 1.0], range(2, 17)):
        if len(extended) > len(program):  # sin(x)/y over sin(x) is shorter
            assert structure_length(extended) > structure_length(program)


def misfit(low=0.81, high=1.21, counts=300.0, pieces=20.0, below=20.0, least=0.0):
    return TrajectoryMisfit(*(np.array([each]) for each in (low, high, least, counts, pieces, below)))


def test_near_the_independent_errors_every_row_counts():
    its = misfit()
    gain = its.total(np.array([1.1])) - its.total(np.array([0.9]))
    assert gain == pytest.approx(150.0 * np.log(1.1 / 0.9))
    assert its.effective_rows(np.array([1.0])) == pytest.approx([300.0])


def test_far_above_only_pieces_count():
    its = misfit()
    gain = its.total(np.array([1e6])) - its.total(np.array([1e4]))
    assert gain == pytest.approx(10.0 * np.log(100.0), rel=1e-3)
    assert its.effective_rows(np.array([1e6])) == pytest.approx([20.0], rel=1e-3)


@given(square=st.floats(1e-6, 1e6), low=st.floats(0.1, 1.0), pieces=st.floats(1.0, 300.0))
def test_the_misfit_rises_without_jumps_at_the_rate_of_the_rows_that_decide(square, low, pieces):
    its, step = misfit(low=low, pieces=pieces, below=pieces), 1e-5
    before, after = its.total(np.array([square])), its.total(np.array([square * (1.0 + step)]))
    rows = its.effective_rows(np.array([square]))[0]
    assert pieces - 1e-6 <= rows <= 300.0 + 1e-6
    assert after - before == pytest.approx(0.5 * rows * step, rel=0.1, abs=1e-6)


def test_below_the_errors_of_the_integration_nothing_counts():
    its = misfit(low=1.0, high=1.0, counts=20.0, below=2.0, least=1e-16)
    assert its.total(np.array([1e-20])) == its.total(np.array([1e-16]))
    assert its.total(np.array([1.0])) - its.total(np.array([1e-16])) == pytest.approx(np.log(1e16))
