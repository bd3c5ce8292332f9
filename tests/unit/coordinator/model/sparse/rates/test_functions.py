"""Products with functions that a polynomial may lack."""

import numpy as np

from atoll_coordinator.model.sparse.rates.functions import dictionary
from atoll_coordinator.model.sparse.rates.rate_laws import _without_first
from atoll_coordinator.model.sparse.shapes import Atom
from atoll_core.expression.operators import BY_NAME


def test_quotients_keep_their_products_where_all_functions_are_too_many() -> None:
    inputs = np.random.default_rng(0).uniform(0.1, 1.0, (8, 20))
    quotients = {BY_NAME["/"].code}
    alone = dictionary(inputs, range(8), quotients)
    made = dictionary(inputs, range(8), quotients | {BY_NAME[name].code for name in ("sin", "cos", "exp", "tanh")})
    assert max(len(shape.factors) for shape in alone) == 2
    assert sum(len(shape.factors) == 2 for shape in made) == sum(len(shape.factors) == 2 for shape in alone)
    assert len(made) > len(alone)


def test_the_function_taken_in_first_leaves_and_the_others_stay() -> None:
    inputs = np.random.default_rng(0).uniform(0.1, 1.0, (1, 20))
    first, second, *_ = dictionary(inputs, (0,), {BY_NAME["/"].code})
    linear = Atom(first.__class__((0,), inputs[0]))
    atoms = [linear, Atom(first, 0.1), Atom(second, 0.2)]
    assert _without_first(atoms) == [atoms[0], atoms[2]]
    assert _without_first([linear]) == [linear]
