"""Smaller programs made of a program."""

from atoll_coordinator.model.structure.moves.reductions import multiply_out, reductions
from atoll_core.expression.program import structure
from tests.unit.coordinator.model.fitting import parsed, shown


def reduced_to(text: str) -> list[str]:
    return [shown(program) for program in reductions(parsed(text))]


def test_an_operator_gives_way_to_its_arguments_or_a_constant():
    assert {"x", "-sin(y)", "x - y", "x - 1.5"} <= set(reduced_to("x - sin(y)"))


def test_a_constant_gives_way_to_neutral_elements():
    assert {"y", "x + y", "y - x"} <= set(reduced_to("2.5*x + y"))


def test_a_shared_factor_is_taken_out():
    assert any(
        text in ("(2.0*y + 3.0)*x", "x*(2.0*y + 3.0)", "x*(3.0 + 2.0*y)") for text in reduced_to("2.0*y*x + 3.0*x")
    )
    assert any("/y" in text and text.count("y") == 1 for text in reduced_to("sin(x)/y - cos(x)/y"))


def test_phases_and_double_angles_are_tried_away():
    assert "cos(x)" in reduced_to("sin(x + 1.5708)")
    assert "cos(y)**2" in reduced_to("cos(2.0*y)")


def test_a_constant_and_a_quotient_become_one_quotient():
    assert "x/(1.5 + x)" in reduced_to("1.0 - 1.5/(1.5 + x)")
    assert "y - 2.0*x/(3.0 + x)" in reduced_to("y + 6.0/(3.0 + x) - 2.0")
    assert "2.0*x*y/(3.0 - x)" in reduced_to("y*(6.0/(3.0 - x) - 2.0)")


def test_reductions_are_smaller_and_told_once():
    program = parsed("0.45*cos(2.0*y)*sin(x) + 0.55*sin(x) - x/(1.0 + y)")
    reduced = list(reductions(program))
    assert len({structure(shorter) for shorter in reduced}) == len(reduced) > 20
    assert all(len(shorter) <= len(program) for shorter in reduced)


def test_a_sum_with_one_is_multiplied_out_and_loses_its_constant():
    assert {"0.5*(y - y*x**2) - x", "0.5*(y - x**2*y) - x"} & set(reduced_to("0.5*y*(0.998 - x**2) - x"))
    program = parsed("y*(3.0 - 1.002*x)")
    numbers = [place for place, (code, *_) in enumerate(program.nodes()) if code == 1]
    texts = {shown(one) for place in numbers for one in multiply_out(program, place)}
    assert texts == {"y - y*(1.002*x)"} or texts == {"y - 1.002*x*y"} or texts == {"y - 1.002*y*x"}
