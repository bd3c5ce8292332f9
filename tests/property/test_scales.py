"""A model in other units is the same model: whatever is said of it is the same, in those units.

Factors are powers of two from 1e-12 to 1e12, by which numbers change without rounding: what comes out otherwise has met
a number that has a unit and should have none.
"""

import re
import shutil
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest

from atoll.analysis.analysis import analyse
from atoll.analysis.box import Box
from atoll.analysis.conserved import conserved_quantities, is_volume_preserving
from atoll.analysis.continuation import continuation, special_points
from atoll.analysis.continuation_parameter import ContinuationParameter
from atoll.analysis.cycle_continuation import cycle_continuation
from atoll.analysis.fixed_points import fixed_points
from atoll.analysis.flow import Flow
from atoll.analysis.limit_cycles import limit_cycles
from atoll.analysis.lyapunov import lyapunov_spectrum
from atoll.model.joint_errors import JointErrors
from atoll.model.model import Model
from atoll.model.simulation import simulate
from atoll.model.vector_field import VectorField
from atoll_core.data.dataset import FloatArray
from benchmarks.exports import programs
from tests.unit.library.export.exported import run_python
from tests.unit.library.model.results import result

FAR = 40
"""2**40 is 1.1e12."""

UNITS = [(FAR, -FAR, 10, FAR), (-30, -FAR, 0, -FAR)]
SAME = (0, 0, 0, 0)

COMPETITION = {"x": "x*(3.0 - x - 2.0*y)", "y": "y*(2.0 - x - y)"}
VAN_DER_POL = {"x": "y", "y": "(1.0 - x**2)*y - x"}
PENDULUM = {"x": "y", "y": "-2.0*sin(x)"}
PREY = {"x": "x*(1.0 - y)", "y": "y*(x - 2.0)"}
TROUGHS = {"x": "x*(1.0 - y)", "y": "y*(x - 1.0)"}
LORENZ = {"x": "10.0*(y - x)", "y": "x*(28.0 - z) - y", "z": "x*y - 2.6666666666666665*z"}
FOLD = {"x": "u - x**2", "y": "x - y"}
HOPF = {"x": "u*x - y - x*(x**2 + y**2)", "y": "x + u*y - y*(x**2 + y**2)"}
CHAIN = {"a": "-a", "b": "a - 2.0*b", "c": "b - 0.7*c"}
"""From a alone, c has no rate at first, and neither has the rate of it."""


def in_units(equations: Mapping[str, str], sizes: Sequence[float], clock: float) -> dict[str, str]:
    """Return the equations of the states times `sizes` (D,) over the time times `clock`."""
    inverse = {name: f"({1.0 / size!r}*{name})" for name, size in zip(equations, sizes, strict=True)}
    return {
        name: f"{size / clock!r}*({re.sub(r'[a-z]+', lambda its: inverse.get(its[0], its[0]), text)})"
        for (name, text), size in zip(equations.items(), sizes, strict=True)
    }


def units_of(equations: Mapping[str, str], powers: Sequence[int]) -> tuple[FloatArray, float]:
    """Return factors of the states (D,) and of the time."""
    return 2.0 ** np.array(powers[: len(equations)], dtype=np.float64), 2.0 ** powers[-1]


def system(
    equations: Mapping[str, str],
    bounds: Sequence[tuple[float, float]],
    powers: Sequence[int],
    inputs: Sequence[str] = (),
) -> tuple[Flow, Box, FloatArray, float]:
    """Return the flow and the box in other units, and the factors of states (D,) and of the time."""
    sizes, clock = units_of(equations, powers)
    ends = np.array(bounds) * sizes[:, None]
    field = VectorField.of(in_units(equations, sizes.tolist(), clock), inputs)
    return Flow.of(field), Box(ends[:, 0], ends[:, 1]), sizes, clock


SIDES = [(-3.0, 3.0), (-3.0, 3.0)]
POSITIVE = [(0.125, 4.0), (0.125, 4.0)]


def fixed(powers: Sequence[int]) -> Any:
    flow, box, sizes, clock = system(COMPETITION, [(0.0, 4.0), (0.0, 3.0)], powers)
    return [
        (each.kind, each.is_stable, (each.point / sizes).round(9).tolist(),
         (each.eigenvalues * clock).round(9).tolist()) for each in fixed_points(flow, box).points
    ]  # fmt: skip


def cycles(powers: Sequence[int]) -> Any:
    flow, box, sizes, clock = system(VAN_DER_POL, SIDES, powers)
    return [
        (each.is_stable, round(each.period / clock, 6), (np.ptp(each.points, axis=0) / sizes).round(4).tolist())
        for each in limit_cycles(flow, box, fixed_points(flow, box).points).cycles
    ]


def folds(powers: Sequence[int]) -> Any:
    flow, box, sizes, _ = system(FOLD, SIDES, powers, "u")
    found = continuation(flow, box, ContinuationParameter("u", 0.5, inputs=(0,)), (-1.0, 1.0))
    return [(each.kind, round(each.value, 6), (each.point / sizes).round(4).tolist()) for each in special_points(found)]


def hopf(powers: Sequence[int]) -> Any:
    flow, box, _, clock = system(HOPF, [(-1.0, 1.0), (-1.0, 1.0)], powers, "u")
    along, over = ContinuationParameter("u", 0.1, inputs=(0,)), (-0.1, 0.2)
    points = continuation(flow, box, along, over)
    found = cycle_continuation(flow, box, along, over, branches=points)
    return [
        (each.kind, round(each.value, 6), round((each.frequency or 0.0) * clock, 6)) for each in special_points(points)
    ] + [(round(float(each.values[-1]), 6), round(each.cycles[-1].period / clock, 6), each.ends) for each in found]


def laws(powers: Sequence[int]) -> Any:
    found = []
    for equations, sides in ((PENDULUM, SIDES), (PREY, POSITIVE), (COMPETITION, POSITIVE), (CHAIN, [*SIDES, (-3, 3)])):
        flow, box, *_ = system(equations, sides, powers)
        found.append((len(conserved_quantities(flow, box)), is_volume_preserving(flow, box)))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("facts", [fixed, cycles, folds, hopf, laws])
def test_what_an_analysis_finds_has_no_unit(facts: Any) -> None:
    expected = facts(SAME)
    assert all(len(each) for each in expected)
    for powers in UNITS if facts in (fixed, laws) else UNITS[:1]:
        assert facts(powers) == expected, powers


@pytest.mark.slow
@pytest.mark.parametrize("powers", UNITS[:1])
def test_exponents_have_the_unit_of_time_alone(powers: Sequence[int]) -> None:
    sides = [(-20.0, 20.0), (-25.0, 25.0), (0.0, 45.0)]
    flow, box, _, clock = system(LORENZ, sides, powers)
    found = lyapunov_spectrum(flow, box, starts=8, intervals=80)
    assert found is not None
    assert found.exponents * clock == pytest.approx([0.9, 0.0, -14.57], abs=0.4)
    assert (np.diff(found.exponents) < 0.0).all()
    assert found.is_chaotic


@pytest.mark.slow
@pytest.mark.parametrize(("equations", "sides"), [(COMPETITION, [(0.0, 4.0), (0.0, 3.0)]), (VAN_DER_POL, SIDES)])
def test_basins_and_nullclines_have_no_unit(equations: Any, sides: Any) -> None:
    def facts(powers: Sequence[int]) -> Any:
        flow, box, *_ = system(equations, sides, powers)
        its = analyse(flow.field, box)
        return its.basins.reached.tolist(), [len(lines) for lines in its.nullclines], its.cycles.has_family

    assert facts(UNITS[0]) == facts(SAME)


@pytest.mark.parametrize("powers", UNITS)
def test_a_simulation_and_its_bands_are_the_same_in_other_units(powers: Sequence[int]) -> None:
    times, found = np.linspace(0.0, 3.0, 7), []
    for its in (SAME, powers):
        sizes, clock = units_of(CHAIN, its)
        field = VectorField.of(in_units(CHAIN, sizes.tolist(), clock))
        (column,) = (index for index, each in enumerate(field.parameters) if each.value == 0.7)
        errors = JointErrors(field, (column,), np.full((1, 1), 1e-18))
        simulated = simulate(field, np.array([1.0, 0.0, 0.0]) * sizes, times * clock, bands=(errors, 2.0))
        assert simulated.status == "finished"
        assert simulated.stderr is not None
        found.append((simulated.x / sizes, simulated.stderr / sizes))
    np.testing.assert_allclose(found[1][0], found[0][0], rtol=1e-8)
    np.testing.assert_allclose(found[1][1], found[0][1], rtol=1e-3)
    assert found[0][1][-1, 2] == pytest.approx(3e-10, rel=0.9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("equations", "start", "until"), [(CHAIN, (1.0, 0.0, 0.0), 3.0), (TROUGHS, (10.0, 10.0), 20.0)]
)
def test_exports_are_the_same_in_other_units_and_those_of_simulations(
    equations: Mapping[str, str], start: tuple[float, ...], until: float
) -> None:
    found = []
    for powers in (SAME, *UNITS):
        sizes, clock = units_of(equations, powers)
        its = result(in_units(equations, sizes.tolist(), clock))
        begin = dict(zip(equations, (sizes * start).tolist(), strict=True))
        times = np.linspace(0.0, until, 7) * clock
        its["simulation"] = {"trajectories": [{"name": "1", "start": begin, "times": times.tolist()}]}
        model = Model(its)
        found += [model.simulate(has_bands=False).x / sizes, run_python(model.to_python())["simulate"]() / sizes]
        if shutil.which("cc") is not None:
            found.append(programs.c(model) / sizes)
    for each in found[1:]:
        np.testing.assert_allclose(each, found[0], rtol=1e-6)


@pytest.mark.slow
def test_paths_and_densities_of_a_process_are_the_same_in_other_units() -> None:
    found = []
    for size, clock in ((1.0, 1.0), (2.0**-FAR, 2.0**20), (2.0**FAR, 2.0**-FAR)):
        rates = in_units({"x": "1.0 - x"}, [size], clock)["x"]
        its = result({"x": rates, "[x]": f"{0.25 * size * size / clock!r}"})
        del its["symbols"]["[x]"]
        ensemble = {"trajectory": "1", "times": [0.0, 0.5 * clock], "mean": {"x": [2.0 * size, 1.6 * size]}}
        model = Model(its | {"process": {"step": 0.1 * clock, "ensemble": ensemble}})
        paths = model.simulate({"x": 2.0 * size}, np.array([0.0, 0.25, 1.0]) * clock, paths=5)
        density = model.stationary_density(paths=32)
        assert density is not None
        found.append((paths.x / size, density.mean / size, density.sd / size, density.density * size))
    for each in found[1:]:
        for one, other in zip(each, found[0], strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-9)
