"""What runs in the environment of the peers: ``python peer_program.py PATHS.npz MADE.npz NAMES``. Stands alone."""

import json
import sys
import warnings
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
            values = means[1 + index + (power - 1) * size]
            inner = RegularGridInterpolator(tuple(edges), values, bounds_error=False, fill_value=None)
            results[f"Kramers-Moyal averaging:{key}"] = inner(states.T)
    return results


def sparse(points: Any, sides: Any, states: Any, names: list[str]) -> tuple[Any, str, Any]:
    """Return the sparse sum of products that describes `sides`: at all rows, as text, and at `points`."""
    import pysindy as ps

    library = ps.PolynomialLibrary(degree=DEGREE)
    columns = np.asarray(library.fit_transform(points.T))
    labels = library.get_feature_names(names)
    folds = np.arange(len(sides)) * FOLDS // len(sides)
    scores = np.zeros((FOLDS, columns.shape[1]))
    for fold in range(FOLDS):
        train = folds != fold
        for coefficients in history(columns[train], sides[train]):
            size = np.count_nonzero(coefficients) - 1
            errors = sides[~train] - columns[~train] @ coefficients
            scores[fold, max(size, 0)] = np.mean(errors**2)
    best = int(np.argmin(scores.mean(axis=0)))
    excess = scores - scores[:, [best]]
    error = excess.std(axis=0) / np.sqrt(FOLDS)
    size = next(number for number in range(len(error)) if excess.mean(axis=0)[number] <= error[number])
    coefficients = next(c for c in history(columns, sides) if max(np.count_nonzero(c) - 1, 0) == size)
    terms = [
        f"{value!r}*{label.replace('^', '**').replace(' ', '*')}"
        for value, label in zip(coefficients.tolist(), labels, strict=True)
        if value
    ]
    every = np.asarray(library.transform(states.T)) @ coefficients
    return every, "+".join(terms).replace("+-", "-") or "0.0", columns @ coefficients


def history(columns: Any, sides: Any) -> list[Any]:
    """Return the coefficients of each step of stepwise sparse regression, from all terms to one."""
    import pysindy as ps

    scale = np.sqrt((columns**2).mean(axis=0))
    optimizer = ps.SSR(alpha=1e-12, kappa=1e-12, max_iter=columns.shape[1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        optimizer.fit(columns / scale, sides[:, None])
    return [np.ravel(each) / scale for each in optimizer.history_]


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], json.loads(sys.argv[3]))
