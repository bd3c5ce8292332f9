"""The engine: elimination against numpy, errors in columns, robust weights, searches among sums."""

from dataclasses import dataclass

import numpy as np
import pytest

from atoll_coordinator.model.sparse.atoms import product_atoms, products, values_of_products
from atoll_coordinator.model.sparse.kernels.elimination import (
    explained_shares,
    find_shortest_with_each,
    scalar_products,
    spread_window_weights,
    sum_error_products,
    sum_products,
    windowed_sums,
)
from atoll_coordinator.model.sparse.regression import (
    SparseRegression,
    WeightedProducts,
    descend,
    eliminate_columns,
    select_forward,
    shortest,
)
from atoll_coordinator.model.sparse.rows import RateRows


@dataclass(frozen=True)
class Fit:
    """Terms whose description is the longer the farther their sum is from ten."""

    kept: tuple[int, ...]

    @property
    def nats(self):
        return abs(sum(self.kept) - 10) + 0.5 * len(self.kept)


def test_terms_leave_as_long_as_that_is_shorter_by_more_than_the_least_gain():
    def fewer(fit):
        return (Fit(tuple(other for other in fit.kept if other != term)) for term in fit.kept)

    assert descend(Fit((1, 2, 7, 3)), fewer).kept == (1, 2, 7)
    assert descend(Fit((1, 2, 7, 3)), fewer, 4.0).kept == (1, 2, 7, 3)
    assert shortest([None]) is None


class Stored:
    def __init__(self, values):
        self.values = np.array(values)

    def column(self, place):
        return self.values[place]

    def dots(self, vector):
        return self.values @ vector

    def squares(self):
        return (self.values**2).sum(axis=1)


def test_the_column_that_explains_most_comes_first():
    generator = np.random.default_rng(3)
    columns = generator.normal(size=(6, 100))
    columns[5] = columns[0]
    side = 5.0 * columns[4] + columns[1]
    steps = list(select_forward(Stored(columns), side))
    chosen = [place for place, _ in steps]
    assert chosen[:2] == [4, 1]
    assert steps[1][1] < 1e-20 * float(side @ side)
    assert not {0, 5} <= set(chosen)


def test_the_sum_of_squares_is_that_of_least_squares_at_each_step():
    generator = np.random.default_rng(4)
    common = generator.normal(size=60)
    columns = generator.uniform(0.1, 100.0, (9, 1)) * (common + 0.03 * generator.normal(size=(9, 60)))
    side, kept = generator.normal(size=60), []
    for place, square in select_forward(Stored(columns), side):
        residuals = {
            other: ((side - np.linalg.lstsq(columns[[*kept, other]].T, side)[0] @ columns[[*kept, other]]) ** 2).sum()
            for other in set(range(9)) - set(kept)
        }
        assert place == min(residuals, key=residuals.get)
        assert square == pytest.approx(residuals[place], rel=1e-9)
        kept.append(place)
    assert sorted(kept) == list(range(9))


def test_nothing_is_chosen_where_no_column_is_left():
    assert list(select_forward(Stored([[1.0, 1.0]]), np.array([1.0, 2.0]))) == [(0, pytest.approx(0.5))]
    assert list(select_forward(Stored([[0.0, 0.0]]), np.array([1.0, 2.0]))) == []


@pytest.mark.parametrize("variables", [1, 3, 9])
def test_weighted_products_are_columns_of_products(variables):
    generator = np.random.default_rng(5)
    factors, weights, vector = (
        generator.normal(size=(variables, 40)),
        generator.uniform(size=40),
        generator.normal(size=40),
    )
    terms = [*products(range(variables), 2), *((variable,) * 3 for variable in range(variables))]
    expected, columns = weights * values_of_products(terms, factors), WeightedProducts(factors, weights)
    assert np.array([columns.column(place) for place in range(len(terms))]) == pytest.approx(expected, rel=1e-14)
    assert columns.dots(vector) == pytest.approx(expected @ vector, abs=1e-13 * 40)
    assert columns.squares() == pytest.approx((expected**2).sum(axis=1))


@pytest.mark.parametrize("count", [1, 2, 7])
def test_sums_of_products_are_added_in_the_order_of_the_rows(count):
    generator = np.random.default_rng(count)
    rows, weights = generator.normal(size=(30, count)), generator.normal(size=30)
    expected, found = np.zeros((count, count)), np.full((count, count), np.nan)
    for row, weight in zip(rows, weights, strict=True):
        expected += np.triu(np.outer(weight * row, row))
    sum_products(rows, weights, found)
    assert np.array_equal(found, expected)


def run(columns, side, errors=None):
    path = eliminate_columns(columns, side, errors)
    return path.order, path.squares, path.coefficients


def by_numpy(columns, side):
    """Yield what is kept, its coefficients and the sum of squares left, the least needed column gone at each step."""
    kept = list(range(len(columns)))
    while kept:
        matrix = columns[kept].T
        solution, *_ = np.linalg.lstsq(matrix, side, rcond=None)
        yield list(kept), solution, float(((side - matrix @ solution) ** 2).sum())
        variances = np.diag(np.linalg.inv(matrix.T @ matrix))
        kept.pop(int(np.argmin(solution**2 / variances)))


def test_steps_are_those_of_least_squares():
    generator = np.random.default_rng(1)
    columns = generator.normal(size=(5, 40)) * np.array([1.0, 1e3, 1e-3, 1.0, 10.0])[:, None]
    side = 2.0 * columns[0] - 0.3 * columns[3] + 0.1 * generator.normal(size=40)
    order, squares, solved_side = run(columns, side)
    for step, (kept, solution, left) in enumerate(by_numpy(columns, side)):
        assert sorted(order[step:]) == kept
        assert solved_side[step, kept] == pytest.approx(solution, rel=1e-9)
        assert squares[step] == pytest.approx(left, rel=1e-9)
    assert squares[-1] == pytest.approx(float(side @ side))
    first = eliminate_columns(columns, side, steps=1)
    assert first.factors(0) == pytest.approx(solved_side[0], rel=1e-12)
    assert set(order[-2:]) == {0, 3}


def test_a_column_that_is_a_sum_of_others_goes_first():
    generator = np.random.default_rng(2)
    columns = generator.normal(size=(3, 30))
    columns = np.vstack([columns, columns[0] + columns[1]])
    side = columns[0] + columns[2]
    order, squares, _ = run(columns, side)
    assert order[0] == 3
    assert squares[:3] == pytest.approx(0.0, abs=1e-20)


def test_sums_begin_at_the_first_row_of_a_window():
    sums = np.zeros((2, 2))
    values = np.array([[1.0, 2.0, 3.0, 4.0], [0.0, 0.0, 1.0, 0.0]])
    windowed_sums(np.array([0, 2]), np.array([[1.0, 10.0], [1.0, 1.0]]), values, sums)
    assert sums.tolist() == [[21.0, 7.0], [0.0, 1.0]]


@pytest.mark.parametrize("count", range(7))
def test_scalar_products_are_added_in_the_order_of_the_rows(count):
    columns, vector = np.random.default_rng(count).normal(size=(count, 50)), np.random.default_rng(9).normal(size=50)
    found = np.zeros(count)
    scalar_products(vector, columns, found)
    for column, product in zip(columns, found, strict=True):
        total = 0.0
        for first, second in zip(column.tolist(), vector.tolist(), strict=True):
            total += first * second
        assert product == total


def test_each_window_gives_its_weights_to_its_rows():
    first, bump = np.array([0, 2]), np.array([[1.0, 2.0], [3.0, 4.0]])
    squares, halves = np.zeros((2, 4))
    spread_window_weights(first, bump, -bump, np.array([1.0, 10.0]), squares, halves)
    assert squares.tolist() == [1.0, 4.0, 90.0, 160.0]
    assert halves.tolist() == [-1.0, -4.0, -90.0, -160.0]


def test_errors_of_columns_are_propagated_by_their_derivatives():
    """Also with more columns than a block has, and with columns that do not depend on a variable."""
    generator = np.random.default_rng(5)
    gradients = generator.normal(size=(20, 3, 30)) * (generator.uniform(size=(20, 3, 1)) < 0.6)
    variances, (squares, halves) = np.array([0.0, 2.0, 0.5]), generator.uniform(size=(2, 30))
    products, cross = np.full((20, 20), np.nan), np.full(20, np.nan)
    for target in range(3):
        sum_error_products(gradients, variances, target, squares, halves, products, cross)
        assert products == pytest.approx(np.einsum("kvn,mvn,v,n->km", gradients, gradients, variances, squares))
        assert cross == pytest.approx(variances[target] * gradients[:, target] @ halves)


@pytest.mark.parametrize("has_errors", [False, True])
def test_one_more_term_is_the_best_sum_of_an_elimination_with_it(has_errors):
    generator = np.random.default_rng(6)
    columns = generator.normal(size=(7, 50))
    side = columns[1] - 0.4 * columns[4] + 0.1 * generator.normal(size=50)
    errors = (0.3 * np.eye(7), np.linspace(0.0, 0.1, 7)) if has_errors else (np.zeros((0, 0)), np.zeros(0))
    kept, candidates, prices = np.array([1, 3]), np.array([0, 2, 4, 5, 6]), np.arange(1.0, 8.0)
    nats = np.zeros(5)
    find_shortest_with_each(columns, side, *errors, kept, candidates, prices, 50.0, 1e-9, nats)
    for candidate, length in zip(candidates, nats, strict=True):
        places = sorted([*kept, candidate])
        own = (errors[0][np.ix_(places, places)], errors[1][places]) if has_errors else None
        path = eliminate_columns(columns[places], side, own)
        lengths = [
            25.0 * np.log(path.squares[step]) + sum(prices[places[place]] for place in path.order[step:])
            for step in range(3)
        ]
        assert length == pytest.approx(min(lengths))
    assert candidates[np.argmin(nats)] == 4


def test_a_further_term_explains_the_residuals_along_its_part_orthogonal_to_the_terms():
    generator = np.random.default_rng(7)
    factors, functions = generator.normal(size=(3, 40)), generator.normal(size=(2, 40))
    functions[1, 7] = np.inf
    first, weights = np.arange(0, 36, 3), generator.uniform(size=(12, 4))
    counts, squares = np.array([3, 1]), generator.uniform(0.5, 2.0, (2, 12))
    shares, vectors, expected = np.full((2, 3, 2), np.nan), [], np.zeros((2, 3, 2))
    for s in range(2):
        roots = np.sqrt(squares[s])
        basis = np.linalg.qr(generator.normal(size=(12, counts[s] - 1)))[0]
        rest = generator.normal(size=12)
        rest -= basis @ (basis.T @ rest)
        rest /= np.linalg.norm(rest)
        vectors += [rest * roots, *(basis.T * roots)]
        for p in range(3):
            values = factors[p] * functions[0]
            column = roots * np.array([weights[w] @ values[first[w] : first[w] + 4] for w in range(12)])
            column -= basis @ (basis.T @ column)
            expected[s, p, 0] = (column @ rest) ** 2 / (column @ column)
    explained_shares(factors, functions, first, weights, squares, np.array(vectors), counts, 1e-13, shares)
    assert shares == pytest.approx(expected)
    explained_shares(factors, functions, first, weights, squares, np.array(vectors), counts, 1.0, shares)
    assert not shares.any()


def test_coefficients_are_those_of_the_true_columns_where_errors_of_columns_are_as_large():
    """Means of 40 draws; least squares gives 0.5 and 0.5."""
    generator = np.random.default_rng(3)
    true = np.vstack([generator.normal(size=(2, 4000)), np.zeros((1, 4000))])
    true[1] += 2.0 * true[0]
    found = []
    for _ in range(40):
        columns = true + generator.normal(size=true.shape)
        side = 3.0 * true[0] - true[1] + 0.1 * generator.normal(size=4000)
        order, _, solved = run(columns, side, (4000.0 * np.eye(3), np.zeros(3)))
        assert order[0] == 2
        found.append(solved[1])
    assert np.mean(found, axis=0) == pytest.approx([3.0, -1.0, 0.0], abs=0.15)


def rows_of(errors, side):
    """Return three columns as variables, and rates with these errors that they describe."""
    columns = np.random.default_rng(1).normal(size=(3, len(errors))) * np.array([1.0, 1e3, 1e-3])[:, None]
    rows = RateRows(columns, side(columns), errors)
    return rows, SparseRegression(rows, product_atoms(columns, [(0,), (1,), (2,)]))


def test_rows_that_err_far_more_than_they_should_count_little():
    generator = np.random.default_rng(2)
    errors = np.full(300, 1e-3)
    outliers = np.where(np.arange(300) < 60, generator.uniform(0.1, 1.0, 300), 0.0)
    _, regression = rows_of(
        errors, lambda columns: columns.T @ [1.0, -2e-3, 0.0] + errors * generator.normal(size=300) + outliers
    )
    fit = regression.refit((0, 1), 1.0 / errors)
    assert fit.coefficients == pytest.approx([1.0, -2e-3], abs=5e-4)
    assert fit.excess < 2.0
    assert fit.assessment.weights[:60].max() < 0.1 * fit.assessment.weights[60:].mean()


def test_without_outliers_a_fit_is_least_squares():
    generator = np.random.default_rng(3)
    errors = generator.uniform(0.1, 10.0, 300)
    noise = errors * generator.normal(size=300)
    rows, regression = rows_of(errors, lambda columns: columns.T @ [2.0, -1e-3, 5e2] + noise)
    expected = np.linalg.lstsq((rows.inputs / errors).T, rows.sides / errors, rcond=None)[0]
    fit = regression.refit((0, 1, 2), 1.0 / errors)
    assert fit.coefficients == pytest.approx(expected, rel=0.2)
    assert 0.8 < fit.excess < 1.2


def test_terms_that_only_fit_noise_are_pruned():
    errors = np.full(300, 0.1)
    noise = errors * np.random.default_rng(2).normal(size=300)
    _, regression = rows_of(errors, lambda columns: columns.T @ [1.0, -2e-3, 0.0] + noise)
    whole = regression.refit((0, 1, 2), 1.0 / errors)
    pruned = regression.prune(whole)
    assert pruned.kept == (0, 1)
    assert pruned.nats < whole.nats
