"""Fixed points, cycles, basins and exponents beside closed forms and the literature."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from atoll.analysis.analyse import analyse
from atoll.analysis.analysis import Analysis
from atoll.analysis.flow import Box, Flow
from atoll.analysis.lyapunov import lyapunov_spectrum
from atoll.model.vector_field import VectorField
from benchmarks.analysis.check import Check, Timer, near, same
from benchmarks.harness.systems import SYSTEMS

PART: Final = "dynamics"
PI: Final = float(np.pi)
_GLIDER: Final = ((1.0 + 0.05**2) ** -0.25, -float(np.arctan(0.05)))
_PREY: Final = next(float(root.real) for root in np.roots([-1.0, 2.0, 7.0 - 1.0 / 0.075, 4.0]) if abs(root.imag) < 1e-9)
_COEXISTING: Final = (_PREY, (4.0 - _PREY) * (1.0 + _PREY))
"""Where y = (4 - x) (1 + x) = x/(0.075 (1 + x))."""

_LIMIT_S: Final = 10.0
_STROGATZ: Final = "Strogatz 1994"

KNOWN: Final[dict[str, tuple[tuple[tuple[float, float], ...], dict[tuple[float, float], str], str]]] = {
    "glider": (((0.1, 3.0), (-3.0, 3.0)), {_GLIDER: "stable focus"}, "v**4 = 1/(1 + 0.05**2), tan(theta) = -0.05"),
    "bacterial_respiration": (
        ((0.0, 20.0), (0.0, 80.0)), {(10.0, 51.0): "stable focus"}, f"{_STROGATZ}, exercise 7.3.8"
    ),
    "predator_prey": (
        ((0.1, 3.9), (0.1, 40.0)), {_COEXISTING: "unstable focus"}, f"{_STROGATZ}, exercise 7.2.17"
    ),
    "bar_magnets": (
        ((-1.0, 4.0), (-1.0, 4.0)),
        {(0.0, 0.0): "non-hyperbolic", (0.0, PI): "saddle", (PI, 0.0): "saddle", (PI, PI): "unstable node"},
        "by symmetry; the linear part of (0, 0) is singular",
    ),
    "shear_flow": (
        ((-1.0, 4.0), (0.5, 2.5)), {(0.0, PI / 2): "centre", (PI, PI / 2): "centre"}, "reversible by symmetry"
    ),
    "van_der_pol": (((-3.0, 3.0), (-2.0, 2.0)), {(0.0, 0.0): "unstable node"}, "trace 10, determinant 1"),
    "lotka_volterra": (
        ((0.0, 4.0), (0.0, 3.0)),
        {(0.0, 0.0): "unstable node", (0.0, 2.0): "stable node", (1.0, 1.0): "saddle", (3.0, 0.0): "stable node"},
        f"{_STROGATZ}, section 6.4",
    ),
}  # fmt: skip
"""Box, fixed points in it with their kinds, and the source, of the paper's seven systems."""


def checks() -> Iterator[Check]:
    """Yield the figures of the seven systems, of van der Pol's oscillator with mu = 1, and of Lorenz's flow."""
    analyses = {}
    for name, (sides, expected, source) in KNOWN.items():
        timer = Timer()
        analyses[name] = analyse(VectorField.of(SYSTEMS[name].truth), box_of(*sides))
        yield from _fixed_points(name, analyses[name], expected, source)
        yield timer.check(PART, f"{name}: time", _LIMIT_S)
    yield from _van_der_pol(analyses["van_der_pol"])
    yield from _basins(analyses["lotka_volterra"])
    yield from _lorenz()


def box_of(*sides: tuple[float, float]) -> Box:
    """Return the box of these bounds."""
    ends = np.array(sides, dtype=np.float64)
    return Box(ends[:, 0], ends[:, 1])


def _fixed_points(
    name: str, analysis: Analysis, expected: dict[tuple[float, float], str], source: str
) -> Iterator[Check]:
    points = sorted(analysis.fixed_points.points, key=lambda point: tuple(np.round(point.point, 3) + 0.0))
    kinds = [kind for _, kind in sorted(expected.items())]
    yield same(PART, f"{name}: fixed points", [point.kind for point in points], kinds, source)
    if len(points) == len(expected):
        places = np.array([point.point for point in points])
        off = float(np.abs(places - np.array(sorted(expected))).max())
        yield near(PART, f"{name}: largest error of a coordinate", off, 0.0, source, 1e-3)


def _van_der_pol(stiff: Analysis) -> Iterator[Check]:
    source = "Andersen and Geer 1982"
    mild = analyse(VectorField.of({"x": "y", "y": "(1.0 - x**2)*y - x"}), box_of((-3.0, 3.0), (-3.0, 3.0)))
    for analysis, mu, period in ((mild, 1, 6.66328686), (stiff, 10, 19.07837)):
        (cycle,) = analysis.cycles.cycles
        yield near(PART, f"van der Pol, mu = {mu}: period", cycle.period, period, source, 1e-3)
        x = cycle.points[:, 0]
        mean = float(np.mean(mu * (1.0 - x**2)))  # of the divergence, by the rectangle rule over a period
        yield near(
            PART, f"van der Pol, mu = {mu}: log of the multiplier", cycle.log_multiplier_product, mean * cycle.period,
            "integral of the divergence (Liouville)", 1e-2,
        )  # fmt: skip


def _basins(analysis: Analysis) -> Iterator[Check]:
    both = [analysis.basins.fraction(index)[0] for index in range(len(analysis.attractors))]
    yield same(PART, "lotka_volterra: basins", len(both), 2, f"{_STROGATZ}, section 6.4")
    yield near(PART, "lotka_volterra: share of both basins", sum(both), 1.0, f"{_STROGATZ}, section 6.4", 1e-3)
    x, y = analysis.basins.starts.T
    left, right = analysis.basins.reached[(x < 1.0) & (y > 1.0)], analysis.basins.reached[(x > 1.0) & (y < 1.0)]
    sides = len({*left.tolist()}), len({*right.tolist()})
    yield same(PART, "lotka_volterra: attractors on either side of the saddle", sides, (1, 1), "isoclines")


def _lorenz() -> Iterator[Check]:
    lorenz = Flow.of(VectorField.of({"x": "10.0*(y - x)", "y": "x*(28.0 - z) - y", "z": "x*y - 8.0/3.0*z"}))
    spectrum = lyapunov_spectrum(lorenz, box_of((-25.0, 25.0), (-25.0, 25.0), (0.0, 50.0)))
    assert spectrum is not None
    for number, (exponent, expected) in enumerate(
        zip(spectrum.exponents, (0.9056, 0.0, -14.5723), strict=True), start=1
    ):
        name = f"Lorenz: exponent {number} (± {spectrum.standard_errors[number - 1]:.1g})"
        yield near(PART, name, float(exponent), expected, "Sprott 2003", 0.02)
