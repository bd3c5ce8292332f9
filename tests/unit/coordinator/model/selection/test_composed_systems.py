"""Systems whose equations are composed with a template: constants, parameters and bounds in the fit."""

from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.model.selection.comparison import Constraints, ModelComparison
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_core.expression.template import TemplateParameter, read_template
from atoll_core.expression.text.parsing import from_infix
from atoll_core.wire.values import decode_value, encode_value
from tests.unit.coordinator.model.shooting.made import LOTKA, measurements

TIMES = 0.1 * np.arange(40.0)
STARTS = ([1.0, 3.0], [4.0, 1.0], [3.0, 3.0])
WHOLE = tuple(
    from_infix(text, ("x", "y"), merges_constants=False) for text in ("3*x - 2*x*y - 1*x*x", "2*y - 1*x*y - 1*y*y")
)


def compared(sides, parameters=(), *, fixed=(), noise=0.02):
    measured = measurements(LOTKA, STARTS, TIMES, noise=noise)
    plain = ModelComparison(MultipleShooting(measured, 1e-6), ("x", "y"), frozenset(fixed))
    if not sides:
        return plain
    template = read_template(sides, {one.name: one for one in parameters}, ("x", "y")).for_equations(("x", "y"))
    constraints = Constraints(template=template, parameters=template.starts)
    return replace(plain, constraints=constraints)


def parsed(*texts):
    return tuple(from_infix(text, ("x", "y"), merges_constants=False) for text in texts)


def test_a_template_that_is_unknown_as_a_whole_changes_no_bit():
    plain, composed = compared({}), compared({"x": "?", "y": "?"})
    first, second = plain.fit_model(WHOLE), composed.fit_model(WHOLE)
    assert first.nats == second.nats
    assert [program.to_bytes() for program in first.programs] == [program.to_bytes() for program in second.programs]
    assert np.array_equal(first.fit.simulated, second.fit.simulated)


def test_parameters_are_fitted_with_the_unknown_part():
    comparison = compared({"x": "r*x - x*x + ?", "y": "2*y + ?"}, [TemplateParameter("r", start=1.0)])
    model = comparison.fit_model(parsed("-1.5*x*y", "-0.7*x*y - 0.7*y*y"))
    whole = compared({}).fit_model(parsed("3*x - 2*x*y - x*x", "2*y - 1*x*y - 1*y*y"))
    assert model.fit.system.parameter_values == pytest.approx([3.0], rel=0.03)
    assert model.programs[0].constants[0] == pytest.approx(-2.0, rel=0.03)
    assert model.fit.system.count == 4
    assert model.misfit == pytest.approx(whole.misfit, rel=0.05)
    assert model.nats < whole.nats  # nothing is paid for what is given


def test_a_parameter_of_two_equations_is_one_number():
    comparison = compared({"x": "3*x - c*2*x*y - x*x", "y": "2*y - c*x*y - y*y"}, fixed=(0, 1))
    model = comparison.fit_model(parsed("1", "1"))
    assert model.fit.system.count == 1
    assert model.fit.system.parameter_values == pytest.approx([1.0], rel=0.02)


def test_an_unknown_part_of_two_equations_has_one_set_of_constants():
    comparison = compared({"x": "3*x + 2*?1 - x*x", "y": "2*y + ?1 - y*y"}, fixed=(1,))
    model = comparison.fit_model(parsed("-0.5*x*y", "0"))
    assert model.fit.system.count == 1
    assert model.programs[0].constants[0] == pytest.approx(-1.0, rel=0.02)
    there = comparison.equations_of(model)[1].constants
    assert model.programs[0].constants[0] in there.tolist()


def test_bounds_of_a_parameter_hold():
    comparison = compared({"x": "r*x + ?", "y": "?"}, [TemplateParameter("r", 0.5, 2.5)])
    model = comparison.fit_model(parsed("-2*x*y - 1*x*x", "2*y - 1*x*y - 1*y*y"))
    assert model.fit.system.parameter_values[0] == 2.5
    assert model.fit.system.on_bounds.sum() == 1


def test_a_similar_system_starts_with_the_parameters_of_the_other():
    comparison = compared({"x": "r*x + ?", "y": "?"})
    near = comparison.fit_model(parsed("-2*x*y - 1*x*x", "2*y - 1*x*y - 1*y*y"))
    unchanged = comparison.fit_from(near, near.programs, steps=0)
    assert unchanged.fit.system.parameter_values == pytest.approx(near.fit.system.parameter_values)


def test_a_worker_composes_the_same_system():
    comparison = compared({"x": "r*x + ?", "y": "-?1 + 2*y - y*y"}, [TemplateParameter("r", 0.1, 9.0)])
    there = ModelComparison.from_parts(decode_value(encode_value(comparison.parts), type(comparison.parts)))
    programs = parsed("-2*x*y - 1*x*x", "1*x*y")
    here, travelled = comparison.fit_model(programs), there.fit_model(programs)
    assert here.nats == travelled.nats
    assert np.array_equal(here.fit.system.constants, travelled.fit.system.constants)
