"""Bounds on the constants of an equation: what users may say, and what it means for programs."""

import math

import pytest

from atoll_core.errors import UsageError
from atoll_core.expression.program import constant_places, with_constants
from atoll_core.expression.restrictions import EquationBounds, parse_bound
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix

NAMES = ("x", "y")


def parsed(text):
    return from_infix(text, NAMES)


def bounds(*texts):
    return EquationBounds(tuple(parse_bound(text, NAMES) for text in texts))


@pytest.mark.parametrize(
    ("text", "scope", "lower", "upper"),
    [
        ("c > 0", "every", 0.0, math.inf),
        ("0<c<10", "every", 0.0, 10.0),
        ("10 >= constants >= 0", "every", 0.0, 10.0),
        ("|c| < 5", "every", -5.0, 5.0),
        ("-1 < inner", "inner", -1.0, math.inf),
        ("x*y < 0", "term", -math.inf, 0.0),
        ("2 > |x|", "term", -2.0, 2.0),
    ],
)
def test_a_bound_is_read_as_it_is_written(text, scope, lower, upper):
    bound = parse_bound(text, NAMES)
    assert (bound.scope, bound.lower, bound.upper) == (scope, lower, upper)


def test_a_variable_called_c_is_a_term():
    assert parse_bound("c > 0", ("c", "x")).scope == "term"
    assert parse_bound("constants > 0", ("c", "x")).scope == "every"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("c", "not understood"),
        ("c = 3", "not understood"),
        ("0 < c > 1", "not understood"),
        ("a < c < b", "number is expected"),
        ("c > nan", "'nan' where a number is expected"),
        ("3 < c < 1", "allows no number"),
        ("1 < |c| < 2", "around zero"),
        ("x + y < 0", "no single term"),
        ("2*x < 0", "number in its term"),
        ("z < 0", "names no term"),
        ("c < inf", "number is expected"),
    ],
)
def test_what_is_no_bound_is_one_sentence(text, words):
    with pytest.raises(UsageError, match=words) as caught:
        parse_bound(text, NAMES)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "bound", "is_kept"),
    [
        ("3*x - 2*x*y", "c > 0", False),
        ("3*x - 2*x*y", "x*y < 0", True),
        ("x*(3 - 2*y)", "x*y > 0", False),
        ("x*(3 - 2*y)", "|c| < 2.5", False),
        ("-x", "c > 0", False),
        ("x/(2 + y)", "inner > 0", True),
        ("x/(y - 2)", "inner > 0", False),
        ("y", "x < -5", True),
    ],
)
def test_constants_count_with_the_sign_that_they_act_with(text, bound, is_kept):
    assert bounds(bound).are_kept(parsed(text)) is is_kept


def test_a_program_is_laid_out_so_that_each_bound_is_about_one_constant():
    limits = bounds("x*y > -1", "0 < x < 2")
    program = limits.laid_out(parsed("x*(3 - 2*y)"))
    lower, upper = limits.ranges(program)
    assert to_infix(program, NAMES) == "3.0*x - 2.0*x*y"
    assert lower.tolist() == [0.0, -math.inf]  # what is written behind a minus is the negative of the coefficient
    assert upper.tolist() == [2.0, 1.0]
    assert to_infix(limits.clipped(program), NAMES) == "2.0*x - 1.0*x*y"
    assert limits.laid_out(program) is program


def test_a_factor_of_one_is_a_constant_where_a_bound_excludes_one():
    limits = bounds("x < 0.5")
    assert to_infix(limits.clipped(limits.laid_out(parsed("x - y"))), NAMES) == "0.5*x - y"


def test_bounds_on_one_constant_are_kept_together_or_not_at_all():
    assert bounds("c > 3", "x < 2").laid_out(parsed("4*x")) is None
    lower, upper = bounds("c > 1", "x < 2").ranges(parsed("4*x"))
    assert (lower.tolist(), upper.tolist()) == ([1.0], [2.0])


def test_bounds_are_told_with_the_numbers_they_are_about():
    first, second = bounds("x*y < -2", "y > 0").governed(parsed("3*x - 2*x*y"))
    assert (first.values, first.is_active) == ((-2.0,), True)
    assert (second.values, second.is_active) == ((), False)


@pytest.mark.parametrize(
    "text", ["3*x - 2*x*y", "-x - 2*y", "2*cos(3*x - 0.5)", "x**0.7 - 4*exp(-2*x)", "x/(2 + 3*y)", "-2*x*y - 3*x"]
)
def test_layouts_depend_on_the_program_alone(text):
    """What was laid out before must not matter: islands move between workers, threads take turns."""
    program = parsed(text)
    fresh = bounds("|c| < 50", "x*y < 9")
    first = fresh.laid_out(program)
    used = bounds("|c| < 50", "x*y < 9")
    for other in ("x", "y - x*y", "2*x + 3*y", "x*(1 - y)", "sin(x)"):
        used.laid_out(parsed(other))
    assert used.laid_out(program) == first
    assert used.laid_out(first) == first
    flipped = with_constants(first, {place: -first.constants[place] for place in constant_places(first)})
    assert used.laid_out(flipped) is flipped, "other values of constants are no other layout"
    assert [entry.tolist() for entry in used.ranges(flipped)] == [entry.tolist() for entry in fresh.ranges(first)]
