"""Laws of many variables: on derivatives whose errors differ from row to row, and on short windows with noise."""

import numpy as np
import pytest

from atoll_coordinator.model.batches import Spread
from atoll_coordinator.model.pools import Law
from atoll_coordinator.model.sparse.many_variables import UnknownEquation, find_short_laws, window_rows
from atoll_coordinator.model.sparse.rows import RateRows
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.operators import BY_NAME
from atoll_core.expression.program import constant_places
from atoll_core.expression.text.parsing import from_infix
from atoll_core.wire.values import encode_value
from tests.batches import ScatteredBatches
from tests.unit.coordinator.model.sparse.enzyme import NAMES as STATES
from tests.unit.coordinator.model.sparse.enzyme import field, prepared

OPERATORS = {BY_NAME[name].code for name in ("+", "-", "*", "/")}
NAMES = tuple(f"x{place + 1}" for place in range(7))


def laws_of(rows, columns, operators=OPERATORS):
    return find_short_laws({"x": UnknownEquation(rows, columns, operators)})["x"]


def rows_of(law, names=NAMES, count=600):
    """Return rows of a law with errors of very different sizes; some large ones are far larger than they should."""
    generator = np.random.default_rng(4)
    inputs = generator.uniform(0.1, 2.5, (len(names), count))
    exact = values_of(from_infix(law, names), inputs)
    errors = exact.std() * 10.0 ** generator.uniform(-5.0, -1.0, count)
    is_far = (generator.uniform(size=count) < 0.1) & (errors > 1e-3 * exact.std())
    far = np.where(is_far, 100.0, 0.3)
    return RateRows(inputs, exact + errors * far * generator.normal(size=count), errors), exact


@pytest.mark.parametrize(
    ("law", "variables", "constants"),
    [
        ("64*x3 - 16*x3*x6 - 13*x4 + 13*x5 - 100*x4*x7", 7, 5),
        ("128*x3 - 32*x3*x2 - 1.28*x2 - 14.6*x1*x2/(0.0731 + x2*x2*x2*x2)", 3, 5),
    ],
)
def test_the_law_is_found(law, variables, constants):
    rows, exact = rows_of(law, NAMES[:variables])
    (rate_law,) = laws_of(rows, range(variables))
    assert len(constant_places(rate_law.program)) == constants
    assert np.abs(values_of(rate_law.program, rows.inputs) - exact).max() < 1e-3 * exact.std()
    assert rate_law.is_tested
    assert rate_law.excess <= 1.0


def test_what_is_left_of_a_conserved_amount_saturates():
    rows, exact = rows_of("2*x1*(3 - x2)/(3.1 - x2) - 0.7*x2", NAMES[:2])
    (law,) = laws_of(rows, range(2))
    assert len(constant_places(law.program)) <= 4
    assert np.abs(values_of(law.program, rows.inputs) - exact).max() < 1e-3 * exact.std()


def test_what_no_short_sum_describes_has_no_law():
    generator = np.random.default_rng(5)
    rows, exact = rows_of("x1 + x2*x3")
    wrong = RateRows(rows.inputs[:3], exact + generator.normal(size=len(exact)), 1e-3 * np.ones(len(exact)))
    assert laws_of(wrong, range(3), OPERATORS - {BY_NAME["/"].code}) == ()


def test_rows_known_as_well_as_the_trusted_ones_are_trusted():
    alike = RateRows(np.ones((1, 10)), np.arange(10.0), np.ones(10))
    assert len(alike.trusted.sides) == 10
    different = RateRows(np.ones((1, 10)), np.arange(10.0), 1.0 + np.arange(10.0))
    assert different.trusted.sides.tolist() == [0.0, 1.0, 2.0, 3.0]


def equations(operators=OPERATORS):
    recording = prepared().recording
    rows = window_rows(recording, STATES, STATES)
    return {name: UnknownEquation(rows[name], (0, 1), operators) for name in STATES}


@pytest.mark.slow
def test_laws_with_a_flux_in_common_are_found_at_one_percent_of_noise():
    known_laws = equations()
    laws = find_short_laws(known_laws)
    states = np.random.default_rng(1).uniform(0.1, 3.0, (2, 50))
    for place, (name, constants) in enumerate(zip(STATES, (3, 4), strict=True)):
        (law,) = laws[name]
        assert len(constant_places(law.program)) == constants
        assert law.excess <= 1.25
        truth = np.array([field(0.0, state)[place] for state in states.T])
        assert values_of(law.program, states) == pytest.approx(truth, abs=0.1 * truth.std())


@pytest.mark.parametrize("workers", [0, 1, 3])
def test_laws_are_the_same_to_the_byte_wherever_equations_are_searched(workers):
    noisy = equations()
    exact = {
        "u": UnknownEquation(rows_of("0.7*x1 - 0.3*x2/(0.5 + x2)", NAMES[:2], 200)[0], (0, 1), OPERATORS),
        "v": UnknownEquation(rows_of("2*x2", NAMES[:2], 200)[0], (0, 1), OPERATORS),
    }
    for unknown in (noisy, exact):
        batches = ScatteredBatches(workers)
        laws, spread = find_short_laws(unknown), find_short_laws(unknown, Spread(batches))
        assert laws["a" if unknown is noisy else "u"]
        assert encode_value(spread, dict[str, tuple[Law, ...]]) == encode_value(laws, dict[str, tuple[Law, ...]])
        assert {name for name, _ in batches.calls} >= {"laws among many variables"}


def test_where_no_function_is_allowed_there_is_no_law_with_one():
    laws = find_short_laws(equations(OPERATORS - {BY_NAME["/"].code}))
    assert all(
        BY_NAME["/"].code not in law.program.operators.tolist() for laws_found in laws.values() for law in laws_found
    )
