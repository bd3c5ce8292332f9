"""What runs in the environment of the peers: ``python peer_program.py PATHS.npz MADE.npz NAMES``. Stands alone."""

import json
import sys
from itertools import combinations_with_replacement
from typing import Any

import numpy as np

FOLDS = 10
DEGREE = 4
GRID = {1: 200, 2: 60}


def main(given: str, made: str, names: list[str]) -> None:
    """Write the values of each equation at all rows by both methods, and print the equations of the second."""
    with np.load(given) as loaded:
        step = float(loaded["step"])
        paths = [loaded[f"path{number}"] for number in range(len(loaded.files) - 1)]
    results, texts = averaged(paths, step, names), {}
    states = np.concatenate(paths, axis=1)
    points = np.concatenate([path[:, :-1] for path in paths], axis=1)
    moved = np.concatenate([np.diff(path, axis=1) for path in paths], axis=1)
    for index, name in enumerate(names):
        drift, text, residuals = sparse(points, moved[index] / step, states, names)
        results[f"stochastic SINDy:{name}"], texts[name] = drift, text
        square = (moved[index] - step * residuals) ** 2 / step
        results[f"stochastic SINDy:[{name}]"], texts[f"[{name}]"], _ = sparse(points, square, states, names)
    np.savez(made, **results)
    print(json.dumps(texts))


def averaged(paths: list[Any], step: float, names: list[str]) -> dict[str, Any]:
    """Return drift and diffusion of each state at all rows by kernel averages, interpolated between bins."""
    from kramersmoyal import km
    from scipy.interpolate import RegularGridInterpolator

    size, states = len(names), np.concatenate(paths, axis=1)
    low, high = states.min(axis=1), states.max(axis=1)
    away = 1e-3 * (high - low)
    bins = tuple(np.linspace(low[i] - away[i], high[i] + away[i], GRID[size] + 1) for i in range(size))
    powers = np.vstack([np.zeros(size), np.eye(size), 2 * np.eye(size)]).astype(int)
    weights, sums = 0.0, 0.0
    for path in paths:
        found, edges = km(path.T, bins=bins, powers=powers)
        density = found[0] * path.shape[1]
        weights, sums = weights + density, sums + density * found
    with np.errstate(all="ignore"):
        means = np.where(weights > 0.0, sums / weights, np.nan) / step
    results = {}
    for index, name in enumerate(names):
        for power, key in ((1, name), (2, f"[{name}]")):
            values = power * means[1 + index + (power - 1) * size]  # coefficients are moments over their factorial
            inner = RegularGridInterpolator(tuple(edges), values, bounds_error=False, fill_value=None)
            results[f"Kramers-Moyal averaging:{key}"] = inner(states.T)
    return results


def sparse(points: Any, sides: Any, states: Any, names: list[str]) -> tuple[Any, str, Any]:
    """Return the sparse sum of products that describes `sides`: at all rows, as text, and at `points`.

    The fewest terms are taken whose error on rows left out is that of the best number within a standard error.
    """
    terms = [term for degree in range(DEGREE + 1) for term in combinations_with_replacement(range(len(names)), degree)]
    columns = products(terms, points)
    folds = np.arange(len(sides)) * FOLDS // len(sides)
    scores = np.zeros((FOLDS, len(terms)))
    for fold in range(FOLDS):
        train = folds != fold
        for size, coefficients in history(columns[train], sides[train]).items():
            scores[fold, size - 1] = np.mean((sides[~train] - columns[~train] @ coefficients) ** 2)
    best = int(np.argmin(scores.mean(axis=0)))
    excess = scores - scores[:, [best]]
    error = excess.std(axis=0) / np.sqrt(FOLDS)
    size = next(number for number in range(len(error)) if excess.mean(axis=0)[number] <= error[number]) + 1
    coefficients = history(columns, sides)[size]
    texts = [
        "*".join([repr(float(value)), *(names[factor] for factor in term)])
        for value, term in zip(coefficients, terms, strict=True)
        if value
    ]
    return products(terms, states) @ coefficients, "+".join(texts).replace("+-", "-"), columns @ coefficients


def products(terms: list[tuple[int, ...]], points: Any) -> Any:
    """Return the value of each term at each point, one term a column."""
    return np.array([np.prod(points[list(term)], axis=0) for term in terms]).T


def history(columns: Any, sides: Any) -> dict[int, Any]:
    """Return the coefficients for each number of terms: the least one leaves, in units of its column, one by one."""
    scale = np.sqrt((columns**2).mean(axis=0))
    kept, found = list(range(columns.shape[1])), {}
    while kept:
        fitted = np.linalg.lstsq(columns[:, kept] / scale[kept], sides, rcond=None)[0]
        coefficients = np.zeros(columns.shape[1])
        coefficients[kept] = fitted / scale[kept]
        found[len(kept)] = coefficients
        kept.pop(int(np.argmin(np.abs(fitted))))
    return found


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], json.loads(sys.argv[3]))
