"""A table in other units is the same table: a job says the same of it, from the table to what is asked of its result.

Times are not even here. Where they are, the rows nearest to a row may be either of two that are equally far away, and
rounding in one unit may decide otherwise than in another one (docs/reproducibility.md, Other units).
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest

from atoll.api.model import Model
from atoll.experiments.designs import DesignRequest
from atoll.experiments.identifiability import identify
from atoll.experiments.suggestion import suggest
from atoll.report.findings import Findings
from atoll.report.markup import to_text
from atoll.report.trajectories import trajectories
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.pipeline import refine_all
from atoll_coordinator.model.pools import Pool
from atoll_coordinator.model.result.building import Account, VariableOutcome, build_result
from atoll_coordinator.result.result import Result
from atoll_coordinator.tasks.preparing import prepare_job
from atoll_core.config import PRESETS, DataConfig, SpaceConfig
from atoll_core.data.dataset import Dataset, FloatArray, Problem, Target
from atoll_core.data.table import Table
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.text.parsing import from_infix
from atoll_core.search.pareto import FrontEntry
from tests.archipelago import search
from tests.unit.coordinator.data.tables import table_of
from tests.unit.island_worker.evolution.test_island import config_of
from tests.unit.library.experiments.made import measured
from tests.unit.library.report.results import dynamics


@dataclass(frozen=True)
class Units:
    """Factors of the columns x and y and of the time."""

    x: float = 1.0
    y: float = 1.0
    t: float = 1.0

    def of(self, name: str) -> float:
        """Return the factor of a column, or of the derivative behind as many dots."""
        size: float = getattr(self, name[0])
        return size / self.t ** name.count("dot")


SAME = Units()
BINARY = [Units(2.0**-40, 2.0**40, 2.0**20), Units(2.0**40, 2.0**-40, 2.0**-40)]
"""By these, numbers change without rounding."""
DECIMAL = [Units(1e-12, 1e12, 1e6), Units(1e12, 1e-12, 1e-9)]
"""By these, simple numbers stay simple."""

TIMES = np.sort(np.random.default_rng(5).uniform(0.0, 8.0, 30))
PHASES = 1.1 * TIMES
COLUMNS = {"x": 2.0 + np.cos(PHASES), "y": -1.0 - np.sin(PHASES)}
NOISE = 0.02 * np.random.default_rng(6).standard_normal((2, 30))


def turning(units: Units, noise: float) -> Table:
    """Return what turns about (2, -1): x' = 1.1 (y + 1), y' = -1.1 (x - 2)."""
    columns = {name: getattr(units, name) * (part + noise * entry)
               for (name, part), entry in zip(COLUMNS.items(), NOISE, strict=True)}  # fmt: skip
    return table_of({"t": units.t * TIMES, **columns})


def prepared(units: Units, noise: float, **options: Any) -> Dataset:
    config = PRESETS["default"].model_copy(update={"data": DataConfig(**options)})
    return prepare(turning(units, noise), config).dataset


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"order": 2},
        {"robust": True},
        {"offsets": ("x",)},
        {"states": ("x",), "inputs": ("y",)},
        {"states": ("x",), "derivatives": ("y",)},
        {"target": "x", "inputs": ("y",)},
    ],
)
@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_a_search_is_given_the_same_rows_and_derivatives(options: dict[str, Any], noise: float) -> None:
    expected = prepared(SAME, noise, **options)
    for units in BINARY:
        preparation = prepared(units, noise, **options)
        assert preparation.warnings == expected.warnings
        for name, one, other in zip(expected.names, preparation.inputs, expected.inputs, strict=True):
            np.testing.assert_allclose(one / units.of(name), other, rtol=1e-11, atol=1e-11)
        for one, other in zip(preparation.targets, expected.targets, strict=True):
            size = _size_of_target(units, options, one.variable)
            np.testing.assert_allclose(one.values / size, other.values, rtol=1e-11, atol=1e-11)
            assert one.standard_deviation / size == pytest.approx(other.standard_deviation, rel=1e-11)
            assert one.uncertainty == pytest.approx(other.uncertainty, rel=1e-6, abs=1e-13)
            assert one.noise == pytest.approx(other.noise, rel=1e-11)


def _size_of_target(units: Units, options: Mapping[str, Any], name: str) -> float:
    if "target" in options or "derivatives" in options:
        return units.of("x" if "target" in options else "y")
    return units.of(name) / units.t ** options.get("order", 1)


@pytest.mark.parametrize("units", [SAME, *BINARY, *DECIMAL])
def test_a_search_finds_an_equation_in_any_unit(units: Units) -> None:
    number = np.arange(60)
    x, y = 0.5 + number * 37 % 41 / 20.0, 0.25 + number * 29 % 43 / 25.0
    values = (3.0 * x - 2.0 * x * y - x * x) * units.of("xdot")
    target = Target("x", "dx/dt", values, 0.0, float(values.std()))
    problem = Problem(("x", "y"), np.stack([units.x * x, units.y * y]), target)
    space = SpaceConfig(operators=("+", "-", "*"), terminals=7)
    searched = search(problem, config_of(population=32, generations=60, space=space), 3)
    assert min(outcome.best_error for outcome in searched.reports) < 1e-9


# ------------------------------------------------------------------------------------------------------------ results


@cache
def refined(units: Units) -> dict[str, Any]:
    """Return the result of data without noise, of which the search has handed on a wrong equation and the right one."""
    config = PRESETS["default"].model_copy(update={"seed": 1})
    prepared, _ = prepare_job(turning(units, 0.0).to_bytes(), config)
    dataset = prepared.preparation.dataset
    pools = {target.variable: Pool(_front(dataset.problem(target.variable), units)) for target in dataset.targets}
    refinement = refine_all(prepared.preparation, prepared.config, pools, None, prepared.laws)
    outcomes = [VariableOutcome(name, pool.front, 1)
                for name, pool in pools.items()]  # fmt: skip
    done = Account("done", 1.0, 1.0)
    return build_result("j", prepared.config, prepared.preparation, outcomes, done, refinement).as_dict()


def _front(problem: Problem, units: Units) -> tuple[FrontEntry, ...]:
    across, about = (1.1 / units.t, units)
    texts = {
        "x": (f"{across * 0.9 * about.x / about.y!r}*y", f"{across * about.x / about.y!r}*y + {across * about.x!r}"),
        "y": (f"{-across * 0.1 * about.y / about.x!r}*x",
              f"{2.2 * about.y / about.t!r} - {across * about.y / about.x!r}*x"),
    }[problem.target.variable]  # fmt: skip
    front = []
    for text in texts:
        program = from_infix(text, problem.names)
        left = values_of(program, problem.inputs) - problem.target.values
        square = float(np.mean(left * left))
        error = float(np.sqrt(square)) / problem.target.standard_deviation
        front.append(FrontEntry(len(program), error, square, 0, 1, 0, program.to_bytes()))
    return tuple(front)


def rates(contents: dict[str, Any], units: Units) -> FloatArray:
    """Return the right-hand sides (2, R) of a result at the measured rows, in units of 1."""
    inputs = np.stack([getattr(units, name) * scale for name, scale in COLUMNS.items()])
    return np.stack([
        values_of(from_infix(equation["expression"], ["x", "y"]), inputs) / units.of(equation["variable"] + "dot")
        for equation in contents["equations"]
    ])  # fmt: skip


@pytest.mark.parametrize("units", DECIMAL)
def test_a_job_gives_the_same_equations_and_verdicts(units: Units) -> None:
    expected, contents = refined(SAME), refined(units)
    assert [equation["verdict"] for equation in expected["equations"]] == ["exact", "exact"]
    for name in ("verdict", "reason", "origin"):
        assert [equation.get(name) for equation in contents["equations"]] == [
            equation.get(name) for equation in expected["equations"]
        ], name
    assert contents["warnings"] == expected["warnings"]
    exact = np.stack([1.1 * (COLUMNS["y"] + 1.0), -1.1 * (COLUMNS["x"] - 2.0)])
    np.testing.assert_allclose(rates(contents, units), exact, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("units", DECIMAL[:1])
def test_what_is_asked_of_a_result_is_the_same(units: Units) -> None:
    expected, model_there = Model(refined(SAME)), Model(refined(units))
    for model, scale in ((expected, SAME), (model_there, units)):
        data = {"t": TIMES * scale.t, **{name: getattr(scale, name) * part for name, part in COLUMNS.items()}}
        assert model.score(data) == pytest.approx(1.0, abs=1e-9)
        simulated = model.simulate({"x": 2.5 * scale.x, "y": -1.0 * scale.y}, np.array([0.0, 1.0, 5.0]) * scale.t)
        np.testing.assert_allclose(simulated.x[:, 0] / scale.x, 2.0 + 0.5 * np.cos([0.0, 1.1, 5.5]), rtol=1e-6)
        namespace: dict[str, Any] = {}
        exec(model.export("python"), namespace)
        slopes = np.array(namespace["rates"](0.0, [2.5 * scale.x, -0.5 * scale.y])) / [
            scale.of("xdot"),
            scale.of("ydot"),
        ]
        np.testing.assert_allclose(slopes, [0.55, -0.55], rtol=1e-6)


def decay(size: float, clock: float) -> Result:
    """Return a result of x' = -0.5 x with noise of a hundredth and a rival that saturates."""
    times = np.linspace(0.0, 2.0, 12)
    x = size * (2.0 * np.exp(-0.5 * times) + 0.01 * np.random.default_rng(2).standard_normal(12))
    contents = measured({"x": f"{-0.5 / clock!r}*x"}, [(clock * times, {"x": x})], 0.01 * size)
    texts = (f"{-0.5 / clock!r}*x", f"{-4.0 * size / clock!r}*x/({7.0 * size!r} + x)")
    contents["equations"][0]["candidates"] = [
        {"expression": text, "complexity": 3 + 4 * place, "nats": 4.0 * place, "origin": "front", "selected": not place}
        for place, text in enumerate(texts)
    ]
    return Result.of(contents)


@pytest.mark.parametrize(("size", "clock"), [(1e12, 1e-6), (2.0**-40, 2.0**20)])
def test_suggestions_and_profiles_are_the_same(size: float, clock: float) -> None:
    asked = [suggest(decay(*scale), DesignRequest({"x": (0.1 * scale[0], 20.0 * scale[0])}, count=2))
             for scale in ((1.0, 1.0), (size, clock))]  # fmt: skip
    expected, experiments = ([
        [experiment.initial["x"] / scale[0], experiment.times[-1] / scale[1], experiment.information,
         experiment.evidence, len(experiment.times)]
        for experiment in one.experiments
    ] for one, scale in zip(asked, ((1.0, 1.0), (size, clock)), strict=True))  # fmt: skip
    assert asked[1].purpose == asked[0].purpose
    np.testing.assert_allclose(np.array(experiments, float), np.array(expected, float), rtol=1e-5)
    one, other = (identify(decay(*scale))["c1"] for scale in ((1.0, 1.0), (size, clock)))
    assert other.verdict == one.verdict == "determined"
    np.testing.assert_allclose(np.array(other.interval) * clock, one.interval, rtol=1e-5)


# ------------------------------------------------------------------------------------------------------------- report


def scaled(contents: Any, factor: float) -> Any:
    """Return the numbers of trajectories in another unit."""
    if isinstance(contents, dict):
        return {name: scaled(content, factor) for name, content in contents.items()}
    if isinstance(contents, list):
        return [scaled(content, factor) for content in contents]
    return factor * contents if isinstance(contents, float) else contents


def test_pictures_of_a_report_are_the_same() -> None:
    """But for the numbers at their axes."""
    pages = []
    for factor in (1.0, 2.0**-40, 2.0**40):
        contents = dynamics()
        (part,) = contents["simulation"]["trajectories"]
        part |= {name: scaled(part[name], factor) for name in ("times", "values", "lower", "upper", "measured")}
        contents["noise"] = scaled(contents["noise"], factor)
        text = "".join(map(to_text, trajectories(Findings(Result.of(contents), None))))
        pages.append(re.findall(r"<(?:polyline|polygon|path|circle)(?! class=\"grid)[^>]*>", text))
    assert len(pages[0]) > 4
    assert pages[1] == pages[2] == pages[0]
