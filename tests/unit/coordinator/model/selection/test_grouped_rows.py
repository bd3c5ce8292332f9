"""One structure over groups of trajectories whose constants differ."""

from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.model.selection.comparison import Constraints, ModelComparison
from atoll_coordinator.model.selection.grouped_rows import GroupedRows
from atoll_coordinator.model.shooting.measurements import measurements_of
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.model.shooting.system import system_of
from atoll_core.data.dataset import Problem, Target
from atoll_core.expression.program import constant_places
from atoll_core.expression.restrictions import EquationBounds, Restrictions, parse_bound
from atoll_core.expression.text.parsing import from_infix
from tests.unit.coordinator.model.shooting.made import Known, recording

RATES = (0.5, 1.0, 1.7)
TIMES = 0.2 * np.arange(30.0)
GROWTHS = [Known(("x",), lambda _, z, r=r: [r * z[0] * (1.0 - 0.5 * z[0])]) for r in RATES]
LOGISTIC = from_infix("0.8*(x - 0.4*x*x)", ("x",))


def comparison(noise=0.0, bounds=()):
    """Return a comparison over three runs, each with a growth rate of its own and the same capacity."""
    parts = [recording(known, ([0.1],), TIMES, noise=noise, seed=seed) for seed, known in enumerate(GROWTHS)]
    trajectories = tuple(
        replace(part.trajectories[0], name=name, group=name) for part, name in zip(parts, "abc", strict=True)
    )
    whole = replace(parts[0], trajectories=trajectories, groups=("a", "b", "c"))
    measured = measurements_of(whole, [0])
    inputs = measured.smoothed
    slopes = np.concatenate([trajectory.slopes[0] for trajectory in trajectories])
    target = Target("x", "dx/dt", slopes, 0.0, float(slopes.std()))
    problem = Problem(("x",), inputs, target, measured.owners_of_rows)
    texts = tuple(parse_bound(text, ("x",)) for text in bounds)
    restrictions = {0: Restrictions(EquationBounds(texts))} if bounds else {}
    rows = GroupedRows(3, [[problem.of_group(group) for group in range(3)]], restrictions)
    return ModelComparison(MultipleShooting(measured, 1e-6), ("x",), constraints=Constraints(restrictions, rows))


def by_group(model):
    system = model.fit.system
    return system.by_place(system.values)


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_constants_are_fitted_group_by_group(noise):
    model = comparison(noise).fit_model([LOGISTIC])
    by_constant = by_group(model)
    assert model.fit.system.count == 6
    assert by_constant[:, 0] == pytest.approx(RATES, rel=0.1 if noise else 1e-5)
    assert by_constant[:, 1] == pytest.approx([0.5] * 3, rel=0.1 if noise else 1e-5)
    assert model.programs[0].constants[constant_places(model.programs[0])] == pytest.approx(by_constant.mean(axis=0))


def test_a_shared_constant_is_one_number_and_costs_one():
    grouped = comparison(0.02)
    apart = grouped.fit_model([LOGISTIC])
    node = constant_places(LOGISTIC)[1]
    together = grouped.fit_from(apart, apart.programs, shared={(((0, node), 1.0),)})
    assert together.fit.system.count == 4
    assert np.ptp(by_group(together)[:, 1]) == 0.0
    assert together.nats < apart.nats
    rate = constant_places(LOGISTIC)[0]
    assert grouped.fit_from(apart, apart.programs, shared={(((0, rate), 1.0),)}).nats > apart.nats + 10.0


def test_sensitivities_are_those_of_finite_differences():
    fit = comparison(0.02).fit_model([LOGISTIC]).fit
    sensitivities = fit.integrated_sensitivities()
    estimator, step = fit.estimator, 1e-5
    for number in range(fit.system.count):
        moved = fit.system.values.copy()
        moved[number] += step
        other = estimator.fit(fit.system.with_values(moved).with_fixed_constants(), None, 0, fit.starts, fit.errors)
        assert (other.simulated - fit.simulated) / step == pytest.approx(sensitivities[:, :, number].T, abs=1e-2)


def test_an_exchanged_equation_begins_from_each_groups_own_constants():
    grouped = comparison()
    model = grouped.fit_model([GROWTHS[0].parsed("0.3*x")])
    fitted = grouped.fit_replacement(model, 0, LOGISTIC, 40)
    assert by_group(fitted)[:, 0] == pytest.approx(RATES, rel=1e-3)


def test_bounds_are_kept_in_each_group():
    model = comparison(0.02, bounds=("x < 0.8",)).fit_model([LOGISTIC])
    by_constant = by_group(model)[:, 0]
    assert (by_constant <= 0.8).all()
    assert by_constant[1] == by_constant[2] == 0.8
    assert by_constant[0] == pytest.approx(0.5, abs=0.1)


def test_a_group_without_rows_begins_with_the_constants_as_they_are():
    values = np.linspace(0.5, 2.0, 20)
    target = Target("x", "dx/dt", 1.5 * values, 0.0, 1.0)
    problem = Problem(("x",), values[None], target, np.zeros(20, dtype=np.int64))
    rows = GroupedRows(2, [[problem.of_group(group) for group in range(2)]])
    program = from_infix("0.8*x", ("x",))
    system = system_of([program], ("x",), ("x",))
    (place,) = constant_places(program)
    assert rows.constants(system, 0, [()], None)[:, place] == pytest.approx([1.5, 0.8])
