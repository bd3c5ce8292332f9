"""Terms that equations share, fitted together."""

import numpy as np
import pytest

from atoll_coordinator.model.inference.shared_terms import fit_together
from atoll_coordinator.model.inference.standard_errors import estimate_errors
from tests.unit.coordinator.model.shooting.made import Known, compare, measurements

TIMES = 0.05 * np.arange(80.0)
STARTS = ([2.0, 0.3], [0.5, 1.0], [3.0, 0.1], [1.0, 0.1])


def reaction(rate, constant, loss=0.4):
    """Return a substrate that is fed and a product that decays, its gain having its own rate and Michaelis constant."""

    def rates(_, z):
        x, y = z
        return [1.2 - 2.0 * x / (0.8 + x), rate * x / (constant + x) - loss * y]

    return Known(("x", "y"), rates)


def found(known, texts, noise=0.003):
    """Return the comparison, the model whose terms are fitted apart, and the one where they are fitted together."""
    its = compare(known, measurements(known, STARTS, TIMES, noise=noise))
    apart = its.fit_model([known.parsed(text) for text in texts])
    return its, apart, fit_together(its, apart, apart.programs)


ENTERS = ("1.1 - 1.9*x/(0.7 + x)", "3.7*x/(0.9 + x) - 0.5*y")


@pytest.fixture(scope="module")
def together():
    return found(reaction(4.0, 0.8), ENTERS)


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
    its, apart, made = together
    before = np.sqrt(np.diag(estimate_errors(its, apart).covariance))
    errors = estimate_errors(its, made.model).of_constants(made.model.fit.system)
    after = np.sqrt(np.diag(errors.covariance))
    assert (after < before).all()
    assert after[[1, 2]] == pytest.approx(after[[3, 4]] / [2.0, 1.0])
    assert np.abs(errors.values - [1.2, 2.0, 0.8, 4.0, 0.8, 0.4]) == pytest.approx(0.0, abs=4.0 * after.max())


def test_a_factor_that_is_no_simple_multiple_stays_one_of_its_own():
    _, apart, made = found(reaction(2.74, 0.8), ENTERS)
    (term,) = made.terms
    assert term.multiples == {0: None, 1: None}
    assert made.model.fit.system.count == apart.fit.system.count - 1


def test_terms_that_are_alike_by_chance_are_not_fitted_together():
    assert found(reaction(2.1, 1.0), ENTERS)[2] is None


def test_a_variable_alone_is_a_flux_if_it_leaves_as_fast_as_it_enters():
    def rates(loss):
        return Known(("x", "y"), lambda _, z: [1.2 - 0.7 * z[0], 0.7 * z[0] - loss * z[1] * z[1]])

    texts = ("1.1 - 0.8*x", "0.6*x - 0.5*y*y")
    _, _, made = found(rates(0.4), texts)
    (term,) = made.terms
    assert term.multiples == {0: -1.0, 1: 1.0}
