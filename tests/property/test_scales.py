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

from atoll.analysis.analyse import analyse
from atoll.analysis.conserved import conserved_quantities, is_volume_preserving
from atoll.analysis.continuation import ContinuationParameter, continuation, special_points
from atoll.analysis.cycle_continuation import cycle_continuation
from atoll.analysis.fixed_points import fixed_points
from atoll.analysis.flow import Box, Flow
from atoll.analysis.limit_cycles import limit_cycles
from atoll.analysis.lyapunov import lyapunov_spectrum
from atoll.api.model import Model
from atoll.model.simulation import simulate
from atoll.model.vector_field import JointErrors, VectorField
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
        name: f"{size / clock!r}*({re.sub(r'[a-z]+', lambda match: inverse.get(match[0], match[0]), text)})"
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
        (point.kind, point.is_stable, (point.point / sizes).round(9).tolist(),
         (point.eigenvalues * clock).round(9).tolist()) for point in fixed_points(flow, box).points
    ]  # fmt: skip


def cycles(powers: Sequence[int]) -> Any:
    flow, box, sizes, clock = system(VAN_DER_POL, SIDES, powers)
    return [
        (cycle.is_stable, round(cycle.period / clock, 6), (np.ptp(cycle.points, axis=0) / sizes).round(4).tolist())
        for cycle in limit_cycles(flow, box, fixed_points(flow, box).points).cycles
    ]


def folds(powers: Sequence[int]) -> Any:
    flow, box, sizes, _ = system(FOLD, SIDES, powers, "u")
    branches = continuation(flow, box, ContinuationParameter("u", 0.5, inputs=(0,)), (-1.0, 1.0))
    return [
        (point.kind, round(point.value, 6), (point.point / sizes).round(4).tolist())
        for point in special_points(branches)
    ]


def hopf(powers: Sequence[int]) -> Any:
    flow, box, _, clock = system(HOPF, [(-1.0, 1.0), (-1.0, 1.0)], powers, "u")
    along, over = ContinuationParameter("u", 0.1, inputs=(0,)), (-0.1, 0.2)
    points = continuation(flow, box, along, over)
    branches = cycle_continuation(flow, box, along, over, branches=points)
    return [
        (point.kind, round(point.value, 6), round((point.frequency or 0.0) * clock, 6))
        for point in special_points(points)
    ] + [
        (round(float(branch.values[-1]), 6), round(branch.cycles[-1].period / clock, 6), branch.ends)
        for branch in branches
    ]


def laws(powers: Sequence[int]) -> Any:
    series = []
    for equations, sides in ((PENDULUM, SIDES), (PREY, POSITIVE), (COMPETITION, POSITIVE), (CHAIN, [*SIDES, (-3, 3)])):
        flow, box, *_ = system(equations, sides, powers)
        series.append((len(conserved_quantities(flow, box)), is_volume_preserving(flow, box)))
    return series


@pytest.mark.slow
@pytest.mark.parametrize("facts", [fixed, cycles, folds, hopf, laws])
def test_what_an_analysis_finds_has_no_unit(facts: Any) -> None:
    expected = facts(SAME)
    assert all(len(kinds) for kinds in expected)
    for powers in UNITS if facts in (fixed, laws) else UNITS[:1]:
        assert facts(powers) == expected, powers


@pytest.mark.slow
@pytest.mark.parametrize("powers", UNITS[:1])
def test_exponents_have_the_unit_of_time_alone(powers: Sequence[int]) -> None:
    sides = [(-20.0, 20.0), (-25.0, 25.0), (0.0, 45.0)]
    flow, box, _, clock = system(LORENZ, sides, powers)
    spectrum = lyapunov_spectrum(flow, box, starts=8, intervals=80)
    assert spectrum is not None
    assert spectrum.exponents * clock == pytest.approx([0.9, 0.0, -14.57], abs=0.4)
    assert (np.diff(spectrum.exponents) < 0.0).all()
    assert spectrum.is_chaotic


@pytest.mark.slow
@pytest.mark.parametrize(("equations", "sides"), [(COMPETITION, [(0.0, 4.0), (0.0, 3.0)]), (VAN_DER_POL, SIDES)])
def test_basins_and_nullclines_have_no_unit(equations: Any, sides: Any) -> None:
    def facts(powers: Sequence[int]) -> Any:
        flow, box, *_ = system(equations, sides, powers)
        analysis = analyse(flow.field, box)
        return (
            analysis.basins.reached.tolist(),
            [len(lines) for lines in analysis.nullclines],
            analysis.cycles.has_family,
        )

    assert facts(UNITS[0]) == facts(SAME)


@pytest.mark.parametrize("powers", UNITS)
def test_a_simulation_and_its_bands_are_the_same_in_other_units(powers: Sequence[int]) -> None:
    times, series = np.linspace(0.0, 3.0, 7), []
    for dose in (SAME, powers):
        sizes, clock = units_of(CHAIN, dose)
        field = VectorField.of(in_units(CHAIN, sizes.tolist(), clock))
        (column,) = (index for index, parameter in enumerate(field.parameters) if parameter.value == 0.7)
        errors = JointErrors(field, (column,), np.full((1, 1), 1e-18))
        simulated = simulate(field, np.array([1.0, 0.0, 0.0]) * sizes, times * clock, bands=(errors, 2.0))
        assert simulated.status == "finished"
        assert simulated.stderr is not None
        series.append((simulated.x / sizes, simulated.stderr / sizes))
    np.testing.assert_allclose(series[1][0], series[0][0], rtol=1e-8)
    np.testing.assert_allclose(series[1][1], series[0][1], rtol=1e-3)
    assert series[0][1][-1, 2] == pytest.approx(3e-10, rel=0.9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("equations", "start", "until"), [(CHAIN, (1.0, 0.0, 0.0), 3.0), (TROUGHS, (10.0, 10.0), 20.0)]
)
def test_exports_are_the_same_in_other_units_and_those_of_simulations(
    equations: Mapping[str, str], start: tuple[float, ...], until: float
) -> None:
    series = []
    for powers in (SAME, *UNITS):
        sizes, clock = units_of(equations, powers)
        contents = result(in_units(equations, sizes.tolist(), clock))
        begin = dict(zip(equations, (sizes * start).tolist(), strict=True))
        times = np.linspace(0.0, until, 7) * clock
        contents["simulation"] = {"trajectories": [{"name": "1", "start": begin, "times": times.tolist()}]}
        model = Model(contents)
        series += [model.simulate(has_bands=False).x / sizes, run_python(model.to_python())["simulate"]() / sizes]
        if shutil.which("cc") is not None:
            series.append(programs.c(model) / sizes)
    for series_there in series[1:]:
        np.testing.assert_allclose(series_there, series[0], rtol=1e-6)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::atoll.model.simulation.ExtrapolationWarning")
def test_paths_and_densities_of_a_process_are_the_same_in_other_units() -> None:
    series = []
    for size, clock in ((1.0, 1.0), (2.0**-FAR, 2.0**20), (2.0**FAR, 2.0**-FAR)):
        rates = in_units({"x": "1.0 - x"}, [size], clock)["x"]
        contents = result({"x": rates, "[x]": f"{0.25 * size * size / clock!r}"})
        del contents["symbols"]["[x]"]
        ensemble = {"trajectory": "1", "times": [0.0, 0.5 * clock], "mean": {"x": [2.0 * size, 1.6 * size]}}
        model = Model(contents | {"process": {"step": 0.1 * clock, "ensemble": ensemble}})
        paths = model.simulate({"x": 2.0 * size}, np.array([0.0, 0.25, 1.0]) * clock, paths=5)
        density = model.stationary_density(paths=32)
        assert density is not None
        series.append((paths.x / size, density.mean / size, density.sd / size, density.density * size))
    for series_there in series[1:]:
        for one, other in zip(series_there, series[0], strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-9)
