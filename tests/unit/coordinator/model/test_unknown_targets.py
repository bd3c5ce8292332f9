"""Targets of unknown parts and first estimates of parameters, from derivatives."""

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.model.template.parameter_estimates import draw_starts
from atoll_coordinator.model.template.unknown_targets import with_unknown_targets
from atoll_core.config import DataConfig, JobConfig, ParameterConfig, PriorConfig, SpaceConfig
from atoll_core.errors import UsageError
from atoll_core.expression.template import TemplateParameter
from tests.unit.coordinator.model.shooting.made import LOTKA, table

TIMES = 0.05 * np.arange(80.0)
STARTS = ([1.0, 3.0], [4.0, 1.0], [3.0, 3.0])


def prepared(equations, parameters=None, *, noise=0.0, variables_of=None, only=None):
    prior = PriorConfig(equations=equations, parameters=parameters or {})
    space = SpaceConfig(variables_of=variables_of or {})
    config = JobConfig(prior=prior, space=space, data=DataConfig(only=only))
    return with_unknown_targets(prepare(table(LOTKA, STARTS, TIMES, noise), config), config)


def target(preparation, name):
    """Return inputs x and y, and the target of an equation."""
    x, y = preparation.dataset.inputs
    return x, y, preparation.dataset.problem(name).target


@pytest.mark.parametrize(
    ("side", "truth"),
    [
        ("3*x - x**2 + ?", lambda x, y: -2.0 * x * y),
        ("x*(3 - ?) - x**2", lambda x, y: 2.0 * y),
        ("3*x - x**2 - 4*x/?", lambda x, y: 2.0 / y),
        ("3*x - x**2 - 2*x*exp(?)", lambda x, y: np.log(y)),
        ("3*x - x**2 - 2*x*sqrt(?)", lambda x, y: y**2),
        ("3*x - x**2 - 2*x*?**3", lambda x, y: np.cbrt(y)),
    ],
)
def test_the_target_is_the_value_of_the_unknown_part(side, truth):
    if "**3" in side:  # repeated multiplication: the unknown part occurs more than once
        with pytest.raises(UsageError, match="write \\? once, for the whole of it"):
            prepared({"x": side})
        return
    x, y, made = target(prepared({"x": side}), "x")
    assert np.allclose(made.values, truth(x, y), rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("side", ["sin(?)", "abs(?) - x", "?**2", "? + x*?"])
def test_a_side_that_cannot_be_solved_is_refused(side):
    with pytest.raises(UsageError, match="write \\? once, for the whole of it"):
        prepared({"x": side})


def test_parameters_beside_the_unknown_part_are_estimated():
    preparation = prepared({"x": "r*x - k*x**2 + ?(x)*y"}, variables_of={"x": ("x",)})
    assert "cannot be told" in " ".join(prepared({"x": "r*x - k*x**2 + ?"}).dataset.warnings)
    assert preparation.parameters == pytest.approx((3.0, 1.0), rel=1e-3)
    x, _, made = target(preparation, "x")
    assert np.allclose(made.values, -2.0 * x, rtol=1e-2)
    assert made.is_noisy  # estimates have errors, so no equation counts as converged


def test_a_flux_of_two_equations_determines_its_parameter_and_both_targets():
    preparation = prepared(
        {"x": "3*x - 2*?1 - x**2", "y": "2*y - ?1/Y - y**2"}, {"Y": ParameterConfig(lower=0.1, upper=5.0)}
    )
    assert preparation.parameters == pytest.approx((1.0,), rel=1e-3)
    x, y, made = target(preparation, "x")
    assert np.allclose(made.values, x * y, rtol=1e-2)
    assert not any("do not agree" in sentence for sentence in preparation.dataset.warnings)


def test_equations_that_contradict_each_other_are_reported():
    preparation = prepared({"x": "3*x - 2*?1 - x**2", "y": "2*y + ?1 - y**2"})
    assert any("do not agree about the unknown part ?1" in sentence for sentence in preparation.dataset.warnings)


def test_an_equation_with_two_unknown_parts_is_solved_after_the_other():
    preparation = prepared({"x": "3*x - 2*?1 - x**2", "y": "?2 - ?1"})
    _, y, made = target(preparation, "y")
    assert np.allclose(made.values, 2.0 * y - y * y, rtol=1e-2, atol=1e-2)


def test_rows_where_the_factor_vanishes_are_left_out():
    whole = prepared({"x": "3*x - x**2 + ?"}, noise=0.01)
    part = prepared({"x": "3*x - x**2 + (y - 1)*?"}, noise=0.01)
    _, y, made = target(part, "x")
    assert 20 < len(made.values) < whole.dataset.inputs.shape[1]
    assert np.abs(y - 1.0).min() > 0.02
    assert np.isfinite(made.values).all()


def test_starts_fill_the_bounds_and_are_the_same_every_time():
    parameters = (
        TemplateParameter("a", 0.01, 100.0),
        TemplateParameter("b", -1.0, 3.0),
        TemplateParameter("c", start=-2.0),
    )
    starts = draw_starts(parameters, 33)
    assert starts[0].tolist() == [1.0, 1.0, -2.0]
    assert np.array_equal(starts, draw_starts(parameters, 33))
    assert (starts[:, 0] < 0.1).sum() == pytest.approx(8, abs=2)
    assert starts[:, 1].min() < -0.8
    assert (starts[:, 2] < 0.0).all()
