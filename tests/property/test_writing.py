"""Rewriting never fails, whatever constants an expression has: what has no other writing stays as it is."""

import logging
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from atoll_core.expression.program import Program, check_program_bytes
from atoll_core.expression.restrictions import EquationBounds, parse_bound
from atoll_core.expression.simplification import simplify_program
from atoll_core.expression.text.parsing import from_infix
from atoll_core.expression.writing import shortest as search
from atoll_core.expression.writing.expansion import expand_program, factored_forms, raised_quotients, terms_of
from atoll_core.expression.writing.shortest import agree, collected, points_of, shortest, shortest_over
from atoll_core.expression.writing.sums_of_products import FAILURES, UndefinedError
from tests.property.programs import NAMES, programs
from tests.property.test_expressions import QUICK

LARGEST = 1.7976931348623157e308
EXTREME = st.one_of(
    st.sampled_from([0.0, -0.0, 5e-324, 1e-300, 1e-160, 1e-20, 1e20, 1e154, 1e300, LARGEST]).flatmap(
        lambda size: st.sampled_from([size, -size])
    ),
    st.sampled_from([1.0, -1.0, 2.0, -0.3, 0.5, 1.5, 16.0, -16.0]),
    st.floats(allow_nan=False, allow_infinity=False),
)
BOUNDS = [
    EquationBounds((parse_bound(text, NAMES),)) for text in ("c > 0", "|c| < 5", "inner > 0", "x*y < 0", "c > 1e-300")
]
ROWS = np.array([[1.0, 2.0, -1.0], [0.0, 3.0, 1e300], [-1.0, 1e-300, 0.5]])


def write_in_every_way(program: Program) -> None:
    """Call whatever rewrites a program; raises what these raise."""
    shortest_over(program, ROWS)
    for other in (shortest(program), collected(program), *factored_forms(program)):
        check_program_bytes(other.to_bytes(), len(NAMES))
    try:
        list(raised_quotients(terms_of(program)))
    except UndefinedError:
        assert expand_program(program) is None
    for bounds in BOUNDS:
        bounds.governed(program)
        if not bounds.are_kept(program):
            laid_out = bounds.laid_out(program)
            if laid_out is not None:
                bounds.laid_out(collected(bounds.clipped(laid_out)))


@pytest.mark.slow
@settings(QUICK, max_examples=100)
@given(programs(largest=10, constants=EXTREME))
def test_no_constant_is_too_extreme(program: Program) -> None:
    FAILURES.clear()
    write_in_every_way(program)
    assert not FAILURES


@pytest.mark.parametrize(
    "text",
    [
        "1.5*x*(-0.3)**y",
        "1.5*x*0.0**y",
        "x*0.0**y/(0.0**y)",
        "sqrt(0.0**y)*0.0**(2.5*y)",
        "exp(16*log(1e20*x + y))",
        "exp(16*log(1e-30*x))",
        "1e-300*(x + 1e-300*y)/(1e-300*x + y)",
        "1e300*x/(1e-300*y + 1e300)**2",
        "(1e200*x + 1e-200*y)**2 + 1e-320*x",
    ],
)
def test_extremes_that_once_ended_an_island_are_left_as_they_are_or_written(text: str) -> None:
    FAILURES.clear()
    write_in_every_way(from_infix(text, NAMES))
    assert not FAILURES


def test_a_bound_that_makes_a_base_zero_refuses_the_program() -> None:
    bounds = BOUNDS[0]
    laid_out = bounds.laid_out(from_infix("1.5*x*(-0.3)**y", NAMES))
    assert laid_out is not None
    assert bounds.laid_out(collected(bounds.clipped(laid_out))) is None


def test_values_of_all_sizes_agree_with_themselves_alone() -> None:
    huge, other = (from_infix(text, NAMES) for text in ("1e308*x", "1.5e308*x"))
    points = points_of(np.array([[1.0, 1.1, 1.2, 1.3], [0.0] * 4, [0.0] * 4]))
    assert agree(huge, huge, points)
    assert not agree(huge, other, points)


def test_a_mistake_in_rewriting_leaves_the_expression_and_is_logged_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def broken(*_: object) -> None:
        raise IndexError("a mistake")

    monkeypatch.setattr(search, "multiply", broken)
    FAILURES.clear()
    with caplog.at_level(logging.WARNING):
        for number in (math.pi, math.e):  # both are unknown to the caches
            program = from_infix(f"x*(y + {number!r}*x) + x*y*0.123", NAMES)
            assert shortest(program) == collected(program) == simplify_program(program)
            assert expand_program(program) is None
            assert not list(factored_forms(program))
    assert sum(FAILURES.values()) > 2
    assert [record.levelname for record in caplog.records].count("WARNING") == len(FAILURES)
    FAILURES.clear()
