"""Terms that equations share, fitted together."""

import numpy as np
import pytest

from atoll_coordinator.model.inference import shared_terms
from atoll_coordinator.model.inference.final_model import estimate_errors, estimate_errors_of_constants
from atoll_coordinator.model.inference.shared_terms import fit_shared_terms
from atoll_core.expression.text.parsing import from_infix
from atoll_core.expression.writing.expansion import expand_program
from tests.unit.coordinator.model.shooting.made import Known, compare, measurements

TIMES = 0.05 * np.arange(80.0)
STARTS = ([2.0, 0.3], [0.5, 1.0], [3.0, 0.1], [1.0, 0.1])


def reaction(rate, constant, loss=0.4):
    """Return a substrate that is fed and a product that decays, its gain having its own rate and Michaelis constant."""

    def rates(_, z):
        x, y = z
        return [1.2 - 2.0 * x / (0.8 + x), rate * x / (constant + x) - loss * y]

    return Known(("x", "y"), rates)


def fitted_together(known, texts, noise=0.003):
    """Return the comparison, the model whose terms are fitted apart, and the one where they are fitted together."""
    comparison = compare(known, measurements(known, STARTS, TIMES, noise=noise))
    apart = comparison.fit_model([known.parsed(text) for text in texts])
    return comparison, apart, fit_shared_terms(comparison, apart, apart.programs)


ENTERS = ("1.1 - 1.9*x/(0.7 + x)", "3.7*x/(0.9 + x) - 0.5*y")


@pytest.fixture(scope="module")
def together():
    return fitted_together(reaction(4.0, 0.8), ENTERS)


def test_a_flux_that_leaves_and_enters_has_one_set_of_constants(together):
    _, apart, made = together
    (term,) = made.terms
    assert term.multiples == {0: -1.0, 1: 2.0}
    assert made.model.fit.system.count == apart.fit.system.count - 2
    assert made.model.nats < apart.nats
    texts = [reaction(4.0, 0.8).text(program) for program in made.model.programs]
    assert texts[0].count("/") == texts[1].count("/") == 1
    constants = [program.constants[program.operators == 1] for program in made.model.programs]
    assert constants[1][0] == pytest.approx(2.0 * constants[0][1], rel=1e-12)
    assert constants[1][1] == constants[0][2]


def test_its_constants_are_known_better(together):
    comparison, apart, made = together
    before = np.sqrt(np.diag(estimate_errors(comparison, apart).covariance))
    errors = estimate_errors_of_constants(comparison, made.model)
    after = np.sqrt(np.diag(errors.covariance))
    assert (after < before).all()
    assert after[[1, 2]] == pytest.approx(after[[3, 4]] / [2.0, 1.0])
    assert np.abs(errors.values - [1.2, 2.0, 0.8, 4.0, 0.8, 0.4]) == pytest.approx(0.0, abs=4.0 * after.max())


def test_a_factor_that_is_no_simple_multiple_stays_one_of_its_own():
    _, apart, made = fitted_together(reaction(2.74, 0.8), ENTERS)
    (term,) = made.terms
    assert term.multiples == {0: None, 1: None}
    assert made.model.fit.system.count == apart.fit.system.count - 1


def test_terms_that_are_alike_by_chance_are_not_fitted_together():
    assert fitted_together(reaction(2.1, 1.0), ENTERS)[2] is None


def test_a_variable_alone_is_a_flux_if_it_leaves_as_fast_as_it_enters():
    def rates(loss):
        return Known(("x", "y"), lambda _, z: [1.2 - 0.7 * z[0], 0.7 * z[0] - loss * z[1] * z[1]])

    texts = ("1.1 - 0.8*x", "0.6*x - 0.5*y*y")
    _, _, made = fitted_together(rates(0.4), texts)
    (term,) = made.terms
    assert term.multiples == {0: -1.0, 1: 1.0}


def paired(one: str, other: str) -> list[tuple[float, ...]]:
    """Return the numbers that stand in the same place of the one term that two expressions have."""
    expansions = [expand_program(from_infix(text, ("x", "y"))) for text in (one, other)]
    ((those),) = shared_terms._find_common_terms(expansions).values()
    if len({term.layout for term in those}) > 1:
        return []
    numbers = [[expansions[term.equation].program.constants[place[1]] * sign for place, sign in term.inner]
               for term in those]  # fmt: skip
    return sorted(zip(*numbers, strict=True))


def test_numbers_are_paired_by_their_places_not_by_their_size():
    one, other = "3*x*y/((1.0 + x)*(1.01 + y))", "-3*x*y/((1.02 + x)*(1.01 + y))"
    assert paired(one, other) == [(1.0, 1.02), (1.01, 1.01)]
    waves = "2*sin(3*x)*exp(-2*y/(4 + x))", "2*sin(2*x)*exp(-5*y/(3 + x))"
    assert paired(*waves) == [(-2.0, -5.0), (3.0, 2.0), (4.0, 3.0)]
    assert paired("x/((1 + x)*(2 + x))", "3*x/((2.1 + x)*(1.1 + x))") == [(1.0, 1.1), (2.0, 2.1)]


def test_terms_that_differ_in_a_number_that_is_not_written_are_not_one():
    assert paired("2*exp(x + 3*y)", "2*exp(3*x + y)") == paired("2*y*exp(x)", "3*y*exp(-x)") == []
