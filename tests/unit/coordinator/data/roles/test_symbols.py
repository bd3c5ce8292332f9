"""Symbols: every column name gets one, and sympy reads each of them back."""

import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st
from sympy.parsing.sympy_parser import parse_expr

from atoll_coordinator.data.roles.roles import assign_symbols


def assert_parsed_back(symbols):
    """Every symbol, in an expression with our functions, is read by sympy as itself."""
    names = list(symbols.values())
    local = {name: sympy.Symbol(name) for name in names}
    text = " + ".join(f"2.5*{name}*sin({name})/cos({name})**2" for name in names)
    assert parse_expr(text, local_dict=local).free_symbols == set(local.values())


def test_identifiers_stay_as_they_are():
    names = ("S", "I", "N", "E", "O", "Q", "beta", "gamma", "zeta", "θ", "x_1", "t", "pi", "re", "oo")
    symbols = assign_symbols(names)
    assert symbols == {name: name for name in names}
    assert_parsed_back(symbols)


def test_keywords_functions_and_other_texts_are_rewritten():
    symbols = assign_symbols(["lambda", "sin", "v/w", "2nd", "x y", "", "%", "Float", "None"])
    assert symbols["lambda"] == "lambda_"
    assert symbols["sin"] == "sin_"
    assert symbols["v/w"] == "v_w"
    assert symbols["2nd"] == "x2nd"
    assert_parsed_back(symbols)


def test_rewritten_names_keep_out_of_the_way_of_others():
    symbols = assign_symbols(["x y", "x_y", "x-y", "lambda", "lambda_"])
    assert symbols["x_y"] == "x_y"
    assert symbols["lambda_"] == "lambda_"
    assert len(set(symbols.values())) == 5


def test_signs_that_python_reads_in_another_form_are_rewritten():
    """Python reads the micro sign as the letter mu."""
    symbols = assign_symbols(["\N{MICRO SIGN}", "\N{GREEK SMALL LETTER MU}"])
    assert len(set(symbols.values())) == 2
    assert_parsed_back(symbols)


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(st.lists(st.text(max_size=6), min_size=1, max_size=4, unique=True))
def test_any_names_get_unique_symbols_that_are_parsed_back(names):
    symbols = assign_symbols(names)
    assert list(symbols) == names
    assert len(set(symbols.values())) == len(names)
    assert_parsed_back(symbols)
