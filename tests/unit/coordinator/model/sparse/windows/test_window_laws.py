"""Laws of many variables with noise, by windows with errors in all variables."""

import numpy as np
import pytest

from atoll_coordinator.model.sparse.windows.window_laws import WindowEquation, find_window_laws
from atoll_coordinator.model.sparse.windows.window_rows import window_rows
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.operators import BY_NAME
from atoll_core.expression.program import constant_places
from tests.unit.coordinator.model.sparse.windows.enzyme import NAMES, field, prepared

OPERATORS = frozenset(BY_NAME[name].code for name in ("+", "-", "*", "/"))


def equations(operators=OPERATORS):
    recording = prepared().recording
    return {name: WindowEquation(window_rows(recording, NAMES, name), (0, 1), operators) for name in NAMES}


@pytest.mark.slow
def test_laws_with_a_flux_in_common_are_found_at_one_percent_of_noise():
    known_laws = equations()
    laws = find_window_laws(known_laws)
    states = np.random.default_rng(1).uniform(0.1, 3.0, (2, 50))
    for place, (name, constants) in enumerate(zip(NAMES, (3, 4), strict=True)):
        (law,) = laws[name]
        assert len(constant_places(law.program)) == constants
        assert law.excess <= 1.25
        truth = np.array([field(0.0, state)[place] for state in states.T])
        assert values_of(law.program, states) == pytest.approx(truth, abs=0.1 * truth.std())


def test_where_no_function_is_allowed_there_is_no_law_with_one():
    laws = find_window_laws(equations(OPERATORS - {BY_NAME["/"].code}))
    assert all(
        BY_NAME["/"].code not in law.program.operators.tolist() for laws_found in laws.values() for law in laws_found
    )
