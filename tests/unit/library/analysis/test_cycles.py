"""Limit cycles, exponents and basins against closed forms and the literature."""

import numpy as np
import pytest

from atoll.analysis.basins import basins, destinations
from atoll.analysis.fixed_points import fixed_points
from atoll.analysis.limit_cycles import limit_cycles
from atoll.analysis.lyapunov import lyapunov_spectrum
from tests.unit.library.analysis.systems import COMPETITION, LORENZ, SUBCRITICAL, VAN_DER_POL, box, flow

SQUARE = box((-3.0, 3.0), (-3.0, 3.0))


@pytest.mark.slow
def test_van_der_pol_has_its_period_and_multipliers() -> None:
    cycles = limit_cycles(VAN_DER_POL, SQUARE, fixed_points(VAN_DER_POL, SQUARE).points)
    (cycle,) = cycles.cycles
    assert cycle.is_stable
    assert cycle.period == pytest.approx(6.66328686, rel=1e-6)
    # exp of the integral of 1 - x**2 over a period, by the rectangle rule, which is exact for smooth periodic functions
    divergence = cycle.period * float(np.mean(1.0 - cycle.points[:, 0] ** 2))
    np.testing.assert_allclose(cycle.multipliers.real, [1.0, np.exp(divergence)], rtol=1e-5)
    assert not cycles.has_family


@pytest.mark.slow
def test_a_stiff_van_der_pol_has_its_period() -> None:
    stiff, where = flow(x="10.0*(y - (x**3/3.0 - x))", y="-x/10.0"), box((-3.0, 3.0), (-2.0, 2.0))
    (cycle,) = limit_cycles(stiff, where, fixed_points(stiff, where).points).cycles
    assert cycle.period == pytest.approx(19.07837, rel=1e-6)  # mu = 10
    assert cycle.log_multiplier_product < -300.0


@pytest.mark.slow
def test_an_unstable_cycle_is_found_in_backward_time() -> None:
    where = box((-2.0, 2.0), (-2.0, 2.0))
    fixed = fixed_points(SUBCRITICAL, where).points
    (cycle,) = limit_cycles(SUBCRITICAL, where, fixed).cycles
    assert not cycle.is_stable
    assert cycle.period == pytest.approx(np.pi)
    assert cycle.multipliers[1].real == pytest.approx(np.exp(2.0 * np.pi), rel=1e-5)
    reached = basins(SUBCRITICAL, where, [point for point in fixed if point.is_stable], grid=20)
    inside = np.hypot(*reached.starts.T) < 1.0
    assert (reached.reached[inside] == 0).all()
    assert (reached.reached[~inside] < 0).all()


@pytest.mark.slow
def test_a_period_two_orbit_is_told_from_the_orbit_inside_it() -> None:
    roessler, where = flow(x="-y - z", y="x + 0.2*y", z="0.2 + z*(x - 3.5)"), box((-8, 8), (-8, 8), (0, 12))
    stable = [cycle for cycle in limit_cycles(roessler, where, ()).cycles if cycle.is_stable]
    assert [cycle.period for cycle in stable] == [pytest.approx(11.65, rel=0.01)]


@pytest.mark.slow
def test_closed_orbits_around_a_centre_are_no_limit_cycles() -> None:
    system, where = flow(x="y", y="-sin(x)"), box((-2.0, 2.0), (-1.5, 1.5))
    cycles = limit_cycles(system, where, fixed_points(system, where).points)
    assert (cycles.cycles, cycles.has_family) == ((), True)


@pytest.mark.slow
def test_lorenz_exponents_are_those_of_the_literature() -> None:
    where = box((-25.0, 25.0), (-25.0, 25.0), (0.0, 50.0))
    spectrum = lyapunov_spectrum(LORENZ, where, starts=128, intervals=300)
    assert spectrum is not None
    assert spectrum.is_chaotic
    np.testing.assert_allclose(spectrum.exponents, [0.9056, 0.0, -14.5723], atol=0.018, rtol=0.005)
    assert abs(spectrum.exponents[0] - 0.9056) < 4.0 * spectrum.standard_errors[0]
    assert spectrum.exponents.sum() == pytest.approx(-41.0 / 3.0, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("more", [{}, {"z": "-z"}])
def test_a_damping_that_grows_with_the_amplitude_leaves_no_closed_orbits(more: dict[str, str]) -> None:
    system, where = flow(x="y", y="-x - 0.1*y**3", **more), box(*[(-2.0, 2.0)] * (2 + len(more)))
    cycles = limit_cycles(system, where, fixed_points(system, where).points)
    assert (cycles.cycles, cycles.has_family) == ((), False)


@pytest.mark.slow
def test_a_cycle_that_is_approached_slowly_is_one() -> None:
    system = flow(x="y", y="0.01*(1.0 - x**2)*y - x")
    cycles = limit_cycles(system, SQUARE, fixed_points(system, SQUARE).points)
    (cycle,) = cycles.cycles
    assert (round(cycle.period, 3), cycles.has_family) == (6.283, False)


@pytest.mark.slow
def test_what_goes_round_with_two_periods_is_no_chaos() -> None:
    two = flow(a="b", b="-a - 0.5*a**3", c="d", d="-2.0*c - 0.3*c**3")
    spectrum = lyapunov_spectrum(two, box(*[(-2.0, 2.0)] * 4), starts=8, intervals=100)
    assert spectrum is not None
    assert not spectrum.is_chaotic
    assert (np.diff(spectrum.exponents) <= 0.0).all()


def test_errors_of_exponents_stay_with_them() -> None:
    two_wells = "2.0*z*(1.0 - z)*(z + 1.5)"  # with slopes of -5 and -7.5
    spectrum = lyapunov_spectrum(
        flow(x="-9.0*x", y="-y", z=two_wells), box(*[(-2.0, 2.0)] * 3), starts=16, intervals=20
    )
    assert spectrum is not None
    assert spectrum.exponents[[0, 2]] == pytest.approx([-1.0, -9.0], abs=0.05)
    assert spectrum.standard_errors[1] > 0.1 > spectrum.standard_errors[[0, 2]].max()


def test_both_basins_of_the_competition_end_at_the_separatrix() -> None:
    where = box((0.0, 4.0), (0.0, 4.0))
    attractors = [point for point in fixed_points(COMPETITION, where).points if point.is_stable]
    reached = basins(COMPETITION, where, attractors, grid=20)
    assert [tuple(attractor.point) for attractor in attractors] == [(0.0, 2.0), (3.0, 0.0)]
    assert reached.fraction(0)[0] + reached.fraction(1)[0] == 1.0
    x, y = reached.starts.T
    assert (reached.reached[(x < 1.0) & (y > 1.0)] == 0).all()  # these quarters beside the saddle keep their courses
    assert (reached.reached[(x > 1.0) & (y < 1.0)] == 1).all()


def test_beyond_two_states_fractions_have_binomial_errors() -> None:
    system, where = flow(x="x - x**3", y="-y", z="-z"), box((-1.0, 3.0), (-1.0, 1.0), (-1.0, 1.0))
    attractors = [point for point in fixed_points(system, where).points if point.is_stable]
    share, error = basins(system, where, attractors).fraction(0)
    assert abs(share - 0.25) < 4.0 * error
    assert error == pytest.approx(np.sqrt(0.25 * 0.75 / 1000), rel=0.1)


def test_courses_without_an_end_are_told_apart() -> None:
    system = flow(x="x**2", y="-y")
    away, _ = destinations(system, SQUARE, (), np.array([[1.0, 0.0], [-1.0, 0.0]]), 10.0)
    assert away.tolist() == [-2, -1]
    assert destinations(flow(x="-1.0/sqrt(x)"), box((0.0, 1.0)), (), np.array([[0.5]]), 10.0)[0].tolist() == [-3]
