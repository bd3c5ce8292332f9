"""Folds, Hopf points and limit cycles along a parameter, beside closed forms and the literature."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from atoll.analysis.analyse import analyse
from atoll.analysis.analysis import Analysis
from atoll.analysis.continuation import special_points
from atoll.analysis.cycle_continuation import CycleBranch
from atoll.model.vector_field import VectorField
from benchmarks.analysis.check import Check, Timer, near, same
from benchmarks.analysis.dynamics import box_of

PART: Final = "branches"
_SQUARE: Final = ((-2.0, 2.0), (-2.0, 2.0))
_LIMIT_S: Final = 10.0


def checks() -> Iterator[Check]:
    """Yield the figures of a cubic, a nerve, three normal forms, van der Pol's oscillator and Rössler's system."""
    yield from _cubic()
    yield from _nerve()
    yield from _normal_forms()
    yield from _van_der_pol()
    yield from _roessler()


def _along(
    equations: dict[str, str], sides: tuple[tuple[float, float], ...], name: str, bounds: tuple[float, float]
) -> Analysis:
    return analyse(VectorField.of(equations), box_of(*sides), vary=(name, bounds))


def _cubic() -> Iterator[Check]:
    analysis = _along({"x": "0.1 + x - x**3"}, ((-2.0, 2.0),), "c1", (-1.0, 1.0))
    folds = [point.value for point in special_points(analysis.branches)]
    for value, expected in zip(folds, (-2.0 / 27.0**0.5, 2.0 / 27.0**0.5), strict=True):
        yield near(PART, "fold of c + x - x**3", value, expected, "zero of the derivative", 1e-6)


def _nerve() -> Iterator[Check]:
    equations = {"v": "0.5 + v - v**3/3.0 - w", "w": "0.08*(v + 0.7 - 0.8*w)"}
    timer = Timer()
    analysis = _along(equations, ((-3.0, 3.0), (-2.0, 3.0)), "c1", (-0.5, 2.0))
    v = np.sqrt(1.0 - 0.8 * 0.08) * np.array([-1.0, 1.0])
    currents = (v + 0.7) / 0.8 - v + v**3 / 3.0
    points = [point for point in special_points(analysis.branches) if point.kind == "Hopf"]
    for point, current in zip(points, currents.tolist(), strict=True):
        yield near(PART, "Hopf point of the FitzHugh-Nagumo nerve", point.value, current, "zero of the trace", 1e-6)
    (branch,) = analysis.cycle_branches
    yield same(PART, "its cycles go from one to the other", branch.ends, ("Hopf point", "Hopf point"), "")
    folds = [fold.value for fold in branch.special]
    yield near(PART, "sum of the currents at its two folds of cycles", sum(folds), 1.75, "by symmetry", 1e-6)
    yield timer.check(PART, "nerve: whole analysis", _LIMIT_S)


def _normal_forms() -> Iterator[Check]:
    hopf = {"x": "0.5*x - y - x*(x**2 + y**2)", "y": "x + 0.5*y - y*(x**2 + y**2)"}
    (branch,) = _along(hopf, _SQUARE, "c1,c2", (-1.0, 1.0)).cycle_branches
    radii = np.array([np.hypot(*cycle.points.T).max() for cycle in branch.cycles])
    off = float(np.abs(radii / np.sqrt(branch.values) - 1.0).max())
    yield near(PART, "Hopf normal form: largest error of the radius", off, 0.0, "sqrt(mu)", 1e-6)
    periods = max(abs(cycle.period / (2.0 * np.pi) - 1.0) for cycle in branch.cycles)
    yield near(PART, "Hopf normal form: largest error of the period", periods, 0.0, "2 pi", 1e-6)
    r = "(x**2 + y**2)"
    bautin = {"x": f"0.5*x - y + x*({r} - {r}**2)", "y": f"x + 0.5*y + y*({r} - {r}**2)"}
    (branch,) = _along(bautin, _SQUARE, "c1,c2", (-1.0, 1.0)).cycle_branches
    yield near(PART, "Bautin's form: fold of cycles", _first(branch), -0.25, "least r**4 - r**2", 1e-6)


def _van_der_pol() -> Iterator[Check]:
    equations = {"x": "y", "y": "(1.0 - x**2)*y - x"}
    analysis = _along(equations, ((-3.0, 3.0), (-20.0, 20.0)), "c1,y:x**2*y", (0.5, 10.0))
    cycle = analysis.cycle_branches[0].cycles[-1]
    yield near(PART, "van der Pol, period at mu = 10", cycle.period, 19.07837, "Andersen and Geer 1982", 1e-3)


def _roessler() -> Iterator[Check]:
    equations = {"x": "-y - z", "y": "x + 0.2*y", "z": "0.2 + z*(x - 2.5)"}
    timer = Timer()
    analysis = _along(equations, ((-8.0, 8.0), (-8.0, 8.0), (0.0, 12.0)), "c3", (2.0, 5.7))
    first, second = analysis.cycle_branches[:2]
    yield near(PART, "Rössler: first period doubling", _first(first), 2.83, "simulations", 5e-3)
    for name, branch, period, multiplier in (
        ("one turn", first, 5.88108845586, -2.403953527),
        ("two turns", second, 11.7586260717, -3.512006980),
    ):
        cycle = branch.cycles[-1]
        yield near(PART, f"Rössler, c = 5.7, {name}: period", cycle.period, period, "ChaosBook.org", 1e-6)
        found_multiplier = float(cycle.multipliers[1].real)
        yield near(PART, f"Rössler, c = 5.7, {name}: multiplier", found_multiplier, multiplier, "ChaosBook.org", 1e-4)
    yield timer.check(PART, "Rössler: whole analysis, three branches of cycles", None)


def _first(branch: CycleBranch) -> float:
    return branch.special[0].value
