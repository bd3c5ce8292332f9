"""The arithmetic of fractions behind the form checker."""

import numpy as np
import pytest

from benchmarks.judging import fractions
from benchmarks.judging.fractions import ONE, Atoms, Fraction, TooLargeError, UndefinedError, atom, constant
from benchmarks.judging.rewriting import rewrite

ANGLES = np.linspace(-3.0, 3.0, 20)


def atoms_xy() -> tuple[Atoms, Fraction, Fraction]:
    atoms = Atoms(20)
    return atoms, atom(atoms.add("x", ANGLES)), atom(atoms.add("y", ANGLES + 5.0))


def test_squares_of_sines_are_replaced_so_that_identities_cancel():
    atoms = Atoms(20)
    sine, cosine = (atom(number) for number in atoms.add_angle("x", ANGLES))
    squares = fractions.add(atoms, fractions.power(atoms, sine, 2), fractions.power(atoms, cosine, 2))
    assert squares.numerator == {ONE: 1.0}
    fifth = fractions.power(atoms, sine, 5)
    assert max(dict(monomial).get(0, 0) for monomial in fifth.numerator) == 1
    assert np.allclose(atoms.evaluate(fifth.numerator), np.sin(ANGLES) ** 5)


def test_products_and_sums_have_the_values_of_their_parts():
    atoms, x, y = atoms_xy()
    total = fractions.add(atoms, fractions.multiply(atoms, x, y), fractions.inverse(y), -2.0)
    values = atoms.evaluate(total.numerator) / atoms.evaluate(total.denominator)
    assert np.allclose(values, ANGLES * (ANGLES + 5.0) - 2.0 / (ANGLES + 5.0))


def test_common_monomials_and_equal_factors_are_cancelled():
    atoms, x, y = atoms_xy()
    total = fractions.add(atoms, x, y)
    assert fractions.multiply(atoms, total, fractions.inverse(total)) == constant(1.0)
    ratio = fractions.multiply(atoms, fractions.multiply(atoms, x, y), fractions.inverse(fractions.power(atoms, x, 3)))
    assert ratio == Fraction({((1, 1),): 1.0}, {((0, 2),): 1.0})


def test_what_cancels_up_to_rounding_is_zero():
    atoms, x, _ = atoms_xy()
    third = Fraction({((0, 1),): 0.1 + 0.2}, {ONE: 1.0})
    assert fractions.add(atoms, third, fractions.multiply(atoms, x, constant(0.3)), -1.0) == constant(0.0)


@pytest.mark.slow
def test_dividing_by_zero_and_too_many_terms_end_the_attempt():
    atoms, x, y = atoms_xy()
    with pytest.raises(UndefinedError):
        fractions.inverse(fractions.add(atoms, x, x, -1.0))
    base = fractions.add(atoms, fractions.add(atoms, x, y), constant(1.0))
    with pytest.raises(TooLargeError):
        fractions.power(atoms, base, 120)


@pytest.mark.parametrize(
    "text",
    [
        "sin(2*x - 3*y + 0.3)*cos(0.5*x)",
        "exp(x - 2*y)/cos(x + 3.141592653589793)",
        "tanh(x*y)*sqrt(y + 9)/(1 + x**2)",
        "abs(x)**1.5 + log(y + 9)**-2",
        "sin(x/(2 + y))**3 - cos(x*y)/y**2",
    ],
)
def test_a_rewritten_expression_has_the_values_of_the_text(text):
    columns = {"x": ANGLES, "y": ANGLES + 5.0}
    both = rewrite(text, text, columns, 0.01)
    assert both.truth == both.model
    found = both.atoms.evaluate(both.model.numerator) / both.atoms.evaluate(both.model.denominator)
    names = {name: getattr(np, name) for name in ("sin", "cos", "exp", "tanh", "sqrt", "log", "abs")}
    assert np.allclose(found, eval(text, names, columns), rtol=1e-10)


def test_angles_inside_one_expression_get_one_base():
    columns = {"x": ANGLES}
    both = rewrite("sin(x)", "cos(0.5*x)*sin(1.5*x)", columns, 0.01)
    assert [name for name in both.atoms.names if name.startswith("sin(0.5")] == ["sin(0.5*x)"]
    assert both.angle_difference == 0.0
