"""Rounding and comparing by sympy, in this process."""

import json

import pytest
import sympy

from benchmarks.peers.simplification import answered, compared, parsed, rounded

XY = ("x", "y")


def test_numbers_are_rounded_to_three_places():
    assert str(rounded(sympy.sympify("0.12349*x + 2.00049"))) == "0.123*x + 2.0"


def test_what_is_next_to_nothing_is_dropped():
    assert parsed("x + 0.00009*y", XY) == sympy.Symbol("x")


def test_fractions_of_whole_numbers_stay_exact():
    assert parsed("x/3", XY) == sympy.Symbol("x") / 3


def test_a_name_of_sympys_can_be_a_variable():
    assert compared("E + 0.1", "E + 1/10", ("E",))["difference"]


@pytest.mark.parametrize(
    ("model", "difference", "ratio"),
    [
        ("x*y + x", True, True),
        ("x*(y + 1) + 7", True, False),
        ("3*x*(1 + y)", False, True),
        ("x*y", False, False),
        ("2", False, False),
        ("x/(y - y)", False, False),
    ],
)
def test_difference_and_ratio_are_constant_or_not(model, difference, ratio):
    answer = compared(model, "x*(y + 1)", XY)
    assert (answer["difference"], answer["ratio"]) == (difference, ratio)


def test_what_sympy_cannot_do_is_no_credit():
    answer = answered(json.dumps({"model": "x +", "truth": "x", "symbols": ["x"]}))
    assert answer["text"].startswith("sympy failed: ")
    assert not answer["difference"]
