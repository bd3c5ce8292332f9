"""Directions in which constants can change together without describing the data worse, and what they leave determined.

The directions are eigenvectors of the curvature of the misfit by the constants, initial states eliminated, each
constant in units of its own size: in logarithmic coordinates where it keeps its sign (Gutenkunst et al. 2007). Letters:
P constants, n points of a profile.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Final

import numpy as np

from atoll.experiments.determination import Direction
from atoll.experiments.profiles import Profile
from atoll.experiments.systems import Fitted
from atoll_core.data.dataset import FloatArray
from atoll_core.quoting import enumerated

SLOPPY: Final = 1.0
"""Quantiles of the error along a direction, over the constants themselves, from which it is not determined: then they
could as well be twice as large, or 0."""
_PART: Final = 0.1
"""Share of the largest component from which a constant takes part in a direction."""
_LEFT: Final = 0.1
"""Share of the change of its terms that a relation may show along a profile and still be called determined."""
_LARGEST_POWER: Final = 3
_LEAST_CURVATURE: Final = 1e-11
"""Share of the largest eigenvalue below which curvature is rounding."""


def directions(fitted: Fitted, profiles: Sequence[Profile], names: Sequence[str], signs: FloatArray,
               quantile: float) -> tuple[Direction, ...]:  # fmt: skip
    """Return the directions, the least determined one first.

    Of each constant there is a profile, its name, and in `signs` (P,) -1 where that stands for minus the constant;
    `quantile` counts the standard errors on either side of an interval.
    """
    sizes = np.maximum(np.abs(fitted.values), 1e-300)
    curvature = np.nan_to_num(fitted.fit.reduced) * np.outer(sizes, sizes)
    values, vectors = np.linalg.eigh(0.5 * (curvature + curvature.T))
    eigendirections = []
    for value, vector in zip(values.tolist(), vectors.T, strict=True):
        error = 1.0 / math.sqrt(value) if value > _LEAST_CURVATURE * values[-1] else math.inf
        is_sloppy = quantile * error >= SLOPPY
        words = _words(vector, profiles, names, signs, quantile) if is_sloppy else ""
        eigendirections.append(Direction(error, vector * np.sign(vector[np.argmax(np.abs(vector))]), is_sloppy, words))
    return tuple(eigendirections)


def _words(vector: FloatArray, profiles: Sequence[Profile], names: Sequence[str], signs: FloatArray,
           quantile: float) -> str:  # fmt: skip
    part: list[int] = np.flatnonzero(np.abs(vector) >= _PART * np.abs(vector).max()).tolist()
    is_open = any(any(profiles[index].is_open) for index in part)
    if len(part) == 1:
        return f"{names[part[0]]} is not determined" if is_open else ""
    listed = enumerated([names[index] for index in part])
    lead = max(part, key=lambda index: abs(float(vector[index])))
    inside = profiles[lead].path[profiles[lead].deviances <= quantile**2][:, part] * signs[part]
    relation = relation_of(inside, (names[part[0]], names[part[1]])) if len(part) == 2 else None
    if relation is not None:
        compared = f"only {relation} is determined, not" if is_open else f"{relation} is determined better than"
        return f"{compared} {listed} by themselves"
    shares = ", ".join(f"{names[index]} by {vector[index] / vector[lead]:+.2g} %" for index in part if index != lead)
    return f"{listed} can change together: as {names[lead]} changes by +1 %, {shares}"


def relation_of(path: FloatArray, names: tuple[str, str]) -> str | None:
    """Return what of two constants stays the same along a path (n, 2), such as ``a*b`` or ``a + b``; None: nothing.

    Products of powers up to cubes are tried, and sums. A sum with another factor than one is said only where no product
    stays the same: along a short path every relation is nearly one of these.
    """
    product, total = _product(path, names), _sum(path, names)
    if total.left <= min(_LEFT, product.left) and (total.is_plain or product.left > _LEFT):
        return total.text
    return product.text if product.left <= _LEFT else None


@dataclass(frozen=True)
class _Relation:
    """How much a relation changes along a path, over the changes of its terms; `is_plain`: without a factor."""

    left: float = math.inf
    text: str = ""
    is_plain: bool = False


def _product(path: FloatArray, names: tuple[str, str]) -> _Relation:
    signs = np.sign(path)
    kept = (signs == np.sign(signs.sum(axis=0))).all(axis=1)  # beyond 0 the same may hold with other signs
    path = path[kept & (path != 0.0).all(axis=1)]
    if len(path) < max(3, len(signs) // 2):
        return _Relation()
    logs = np.log(np.abs(path))
    spread = np.ptp(logs, axis=0)
    if not np.all(spread > 0.0):
        return _Relation()
    ratio = _slope(logs)
    power = Fraction(abs(ratio)).limit_denominator(_LARGEST_POWER)
    if not 0 < power.numerator <= _LARGEST_POWER:
        return _Relation()
    # along the path the logarithm of the second changes by `ratio` times that of the first
    first, second = power.numerator, power.denominator * (1 if ratio < 0.0 else -1)
    left = float(np.ptp(first * logs[:, 0] + second * logs[:, 1])) / float(first * spread[0] + abs(second) * spread[1])
    operator = "*" if second > 0 else "/"
    return _Relation(left, f"{_power(names[0], first)}{operator}{_power(names[1], abs(second))}", True)


def _sum(path: FloatArray, names: tuple[str, str]) -> _Relation:
    spread = np.ptp(path, axis=0) if len(path) > 1 else np.zeros(2)
    if not np.all(spread > 0.0):
        return _Relation()
    ratio = _slope(path)
    factor = float(f"{abs(ratio):.2g}")
    sign = -1.0 if ratio > 0.0 else 1.0
    left = float(np.ptp(factor * path[:, 0] + sign * path[:, 1])) / float(factor * spread[0] + spread[1])
    first = names[0] if factor == 1.0 else f"{factor:g}*{names[0]}"
    return _Relation(left, f"{first} {'+' if sign > 0 else '-'} {names[1]}", factor == 1.0)


def _slope(path: FloatArray) -> float:
    """Return the slope of the second column over the first, of the principal axis of both in their own units."""
    centred = path - path.mean(axis=0)
    scale = centred.std(axis=0)
    return float(scale[1] / scale[0]) * (1.0 if float(centred[:, 0] @ centred[:, 1]) >= 0.0 else -1.0)


def _power(name: str, power: int) -> str:
    return name if power == 1 else f"{name}**{power}"
