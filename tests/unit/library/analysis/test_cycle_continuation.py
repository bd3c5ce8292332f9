"""Branches of limit cycles against closed forms and the literature.

In polar coordinates a cycle r = 1 with phi' = 1 has the period 2 pi, and the multipliers of its neighbours follow from
what is linear in them.
"""

import numpy as np
import pytest

from atoll.analysis.continuation import Coefficients, continuation
from atoll.analysis.cycle_continuation import CycleBranch, cycle_continuation
from atoll.analysis.fixed_points import fixed_points
from atoll.analysis.flow import Box, Flow
from atoll.analysis.limit_cycles import LimitCycle, limit_cycles
from atoll.model.vector_field import VectorField
from tests.unit.library.analysis.systems import LORENZ, VAN_DER_POL, box, flow

SQUARE = box((-2.0, 2.0), (-2.0, 2.0))
CUBE = box((-2.0, 2.0), (-2.0, 2.0), (-2.0, 2.0))
CIRCLE = np.arange(400) * (2.0 * np.pi / 400)


def along(
    system: Flow, where: Box, name: str, bounds: tuple[float, float], *cycles: LimitCycle, has_hopf: bool = False
) -> list[CycleBranch]:
    """Return the branches from `cycles` of the model as it is, or from the Hopf points."""
    explicit, parameter = Coefficients.of(system.field).find(system, name)
    branches = continuation(explicit, where, parameter, bounds) if has_hopf else ()
    known = [(parameter.value, cycle) for cycle in cycles]
    return [*cycle_continuation(explicit, where, parameter, bounds, branches=branches, known=known)]


def unit_circle(size: int) -> LimitCycle:
    """Return the cycle r = 1 of a system of so many states, the others being 0."""
    points = np.zeros((400, size))
    points[:, 0], points[:, 1] = np.cos(CIRCLE), np.sin(CIRCLE)
    return LimitCycle(points[0], 2.0 * np.pi, np.ones(size, dtype=np.complex128), 0.0, points)


@pytest.mark.slow
def test_the_hopf_normal_form_has_circles_of_radius_sqrt_mu() -> None:
    system = flow(x="0.5*x - y - x*(x**2 + y**2)", y="x + 0.5*y - y*(x**2 + y**2)")
    (branch,) = along(system, SQUARE, "c1,c2", (-1.0, 1.0), has_hopf=True)
    assert branch.ends == ("Hopf point", "end of the range")
    radii = [np.hypot(*cycle.points.T) for cycle in branch.cycles]
    np.testing.assert_allclose(radii, np.tile(np.sqrt(branch.values)[:, None], 400), rtol=1e-9)
    np.testing.assert_allclose([cycle.period for cycle in branch.cycles], 2.0 * np.pi, rtol=1e-12)
    exponents = -4.0 * np.pi * branch.values  # r' = mu r - r**3 is -2 mu times what is linear beside the circle
    np.testing.assert_allclose([cycle.log_multiplier_product for cycle in branch.cycles], exponents, rtol=1e-9)
    assert branch.special == ()


@pytest.mark.slow
def test_cycles_of_bautins_form_turn_back_at_a_fold() -> None:
    """r' = r (mu + r**2 - r**4) has circles mu = r**4 - r**2, whose least mu is -1/4."""
    square = "(x**2 + y**2)"
    system = flow(x=f"0.5*x - y + x*({square} - {square}**2)", y=f"x + 0.5*y + y*({square} - {square}**2)")
    (branch,) = along(system, SQUARE, "c1,c2", (-1.0, 1.0), has_hopf=True)
    ((fold),) = branch.special
    assert fold.kind == "fold"
    assert fold.value == pytest.approx(-0.25, abs=1e-9)
    assert np.hypot(*fold.cycle.point) == pytest.approx(0.5**0.5, abs=1e-4)
    assert fold.cycle.multipliers[1] == pytest.approx(1.0, abs=1e-3)
    assert [branch.cycles[at].is_stable for at in (0, -1)] == [False, True]


@pytest.mark.slow
def test_a_branch_joins_the_hopf_points_of_the_nerve() -> None:
    """FitzHugh and Nagumo: its canards have multipliers that change by powers of ten within 1e-8 of the current."""
    nerve = flow(v="0.5 + v - v**3/3.0 - w", w="0.08*(v + 0.7 - 0.8*w)")
    (branch,) = along(nerve, box((-3.0, 3.0), (-2.0, 3.0)), "c1", (-0.5, 2.0), has_hopf=True)
    assert branch.ends == ("Hopf point", "Hopf point")
    assert [point.kind for point in branch.special] == ["fold", "fold"]
    folds = [point.value for point in branch.special]
    assert sum(folds) == pytest.approx(1.75, abs=1e-7)  # turning v, w and the current about the middle keeps the nerve
    for point in branch.special:
        assert point.cycle.multipliers[1].real == pytest.approx(1.0, abs=0.01)


@pytest.mark.slow
def test_van_der_pol_has_its_period_along_mu() -> None:
    where = box((-3.0, 3.0), (-20.0, 20.0))
    system = flow(x="y", y="(1.0 - x**2)*y - x")
    cycles = limit_cycles(VAN_DER_POL, where, fixed_points(VAN_DER_POL, where).points).cycles
    (branch,) = along(system, where, "c1,y:x**2*y", (0.5, 10.0), *cycles)
    assert branch.values[-1] == pytest.approx(10.0, rel=1e-12)
    assert branch.cycles[-1].period == pytest.approx(19.07837, rel=1e-6)  # Andersen and Geer 1982
    assert all(cycle.is_stable for cycle in branch.cycles)


@pytest.mark.slow
def test_a_twisted_neighbourhood_doubles_its_period() -> None:
    """Neighbours of r = 1 that turn by half a turn in each period have the multipliers -exp(2 pi (s + 0.2)) and
    -exp(2 pi (s - 0.2)): s = -0.2 is a period doubling."""
    off = "0.5*(x**2 + y**2 - 1.0)"
    outward = f"((s + 0.2*x)*{off} + (0.2*y - 0.5)*z)"
    across = f"(0.2*y + 0.5)*{off} + (s - 0.2*x)*z"
    field = VectorField.of({"x": f"-y + x*{outward}", "y": f"x + y*{outward}", "z": across}, ["s"])
    branch = along(Flow.of(field, np.array([-0.5])), CUBE, "s", (-1.0, -0.05), unit_circle(3))[0]
    (doubling,) = branch.special
    assert (doubling.kind, doubling.value) == ("period doubling", pytest.approx(-0.2, abs=1e-7))
    assert doubling.cycle.multipliers[1:] == pytest.approx([-1.0, -np.exp(-0.8 * np.pi)], rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "others"),
    [
        ("branch point", {"z": "m*z - z**3"}),
        ("torus", {"z": "m*z - 0.3*w - z*(z**2 + w**2)", "w": "0.3*z + m*w - w*(z**2 + w**2)"}),
    ],
)
def test_other_multipliers_leave_the_unit_circle_at_zero(kind: str, others: dict[str, str]) -> None:
    """Beside r = 1 they are exp(2 pi m), or exp(2 pi (m +- 0.3 i))."""
    circle = {"x": "-y + x*(1.0 - x**2 - y**2)", "y": "x + y*(1.0 - x**2 - y**2)"}
    system = Flow.of(VectorField.of({**circle, **others}, ["m"]), np.array([-0.5]))
    (branch,) = along(system, box(*[(-2.0, 2.0)] * system.size), "m", (-1.0, 1.0), unit_circle(system.size))
    assert [(point.kind, round(point.value, 6) + 0.0) for point in branch.special] == [(kind, 0.0)]


@pytest.mark.slow
def test_lorenz_cycles_end_at_the_homoclinic_orbit() -> None:
    """From the Hopf point at r = 470/19 to r = 13.926 (Sparrow 1982), where no multiplier is known any more."""
    system, where = LORENZ, box((0.5, 25.0), (0.5, 25.0), (1.0, 50.0))  # one of two that are alike
    (branch,) = along(system, where, "c2", (12.0, 26.0), has_hopf=True)
    assert branch.ends == ("Hopf point", "period without bounds")
    assert branch.values[0] == pytest.approx(470.0 / 19.0, abs=0.05)
    assert branch.values[-1] == pytest.approx(13.926, abs=1e-3)
    assert branch.special == ()


@pytest.mark.slow
def test_roessler_doubles_its_period_twice_and_again() -> None:
    """a = b = 0.2. Periods and multipliers of the cycles of one and two turns at c = 5.7: ChaosBook.org, extras,
    Roessler.html. The first doubling is at c = 2.83 (as measured in simulations by many)."""
    system, where = flow(x="-y - z", y="x + 0.2*y", z="0.2 + z*(x - 2.5)"), box((-8, 8), (-8, 8), (0, 12))
    cycles = limit_cycles(system, where, fixed_points(system, where).points).cycles
    branches = along(system, where, "c3", (2.0, 5.7), *(cycle for cycle in cycles if cycle.is_stable))
    doublings = [point.value for branch in branches for point in branch.special]
    np.testing.assert_allclose(doublings, [2.8324, 3.8374, 4.1242], atol=1e-4)
    assert [branch.ends[0] for branch in branches] == ["end of the range", "period doubling", "period doubling"]
    first, second = branches[0].cycles[-1], branches[1].cycles[-1]
    assert first.period == pytest.approx(5.88108845586, rel=1e-9)
    assert first.multipliers[1].real == pytest.approx(-2.403953527, rel=1e-6)
    assert second.period == pytest.approx(11.7586260717, rel=1e-9)
    assert second.multipliers[1].real == pytest.approx(-3.512006980, rel=1e-5)
