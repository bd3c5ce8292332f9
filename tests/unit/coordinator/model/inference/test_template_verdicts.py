"""Verdicts of jobs with templates and hidden states: what the data do not determine is never good."""

from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.data.prior_knowledge import resolve_prior
from atoll_coordinator.data.templates import template_of
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.hidden.alternation import with_hidden_states
from atoll_coordinator.model.pipeline import refine_all
from atoll_coordinator.model.template.unknown_targets import with_unknown_targets
from atoll_core.config import DataConfig, JobConfig, ParameterConfig, PriorConfig, SpaceConfig
from atoll_core.data.table import Table
from tests.unit.coordinator.model.shooting.made import Known, pools, table

PENDULUM = Known(("theta", "v"), lambda _, z: [z[1], -7.0 * np.sin(z[0]) - 0.3 * z[1]])
DRUG = Known(("c", "p"), lambda _, z: [-0.8 * z[0] + 0.25 * z[1], 0.5 * z[0] - 0.25 * z[1]])
TIMES = 0.05 * np.arange(120.0)
DAYS = 0.2 * np.arange(80.0)
HIDDEN = DataConfig(hidden=("p",))
DRUG_SIDES = {"c": "-k*c - a*c + b*p", "p": "a*c - b*p"}
RATES = {name: ParameterConfig(lower=0.01, upper=10.0) for name in "kab"}


def refined(
    made: Table, sides, parameters=None, *, data=None, initial=None, pool=None, variables_of=None, limits=None,
    deadline=None,
):  # fmt: skip
    """Return the refinement of a table by a template; `pool` has what a search might hand on, by equation."""
    prior = PriorConfig(equations=sides, parameters=parameters or {}, initial=initial or {}, limits=limits or {})
    space = SpaceConfig(operators=("+", "-", "*"), variables_of=variables_of or {})
    config = JobConfig(prior=prior, data=data or DataConfig(), space=space)
    preparation = prepare(made, config)
    config = resolve_prior(config, preparation.dataset.variables, preparation.dataset.symbols)
    preparation = with_unknown_targets(with_hidden_states(preparation, config), config)
    assert template_of(config, preparation.dataset.names) is not None
    return refine_all(preparation, config, pools(preparation, **(pool or {})), deadline)


def without(made: Table, *names: str) -> Table:
    """Return a table without these columns."""
    kept = [place for place, name in enumerate(made.names) if name not in names]
    return replace(
        made, names=tuple(made.names[place] for place in kept), units=("",) * len(kept),
        columns=np.ascontiguousarray(made.columns[kept]),
    )  # fmt: skip


def grades(refinement):
    return {name: equation.grade for name, equation in refinement.equations.items()}


def check(refinement, name, which):
    return next(one for one in refinement.equations[name].checks if one.name == which)


def test_given_equations_have_their_parameters_and_are_good():
    made = table(PENDULUM, ([2.0, 0.0],), TIMES, noise=0.01)
    refinement = refined(
        made, {"theta": "v", "v": "-g*sin(theta) - c*v"}, {"g": ParameterConfig(lower=1.0, upper=30.0)}
    )
    assert grades(refinement) == {"theta": "good", "v": "good"}
    equation = refinement.equations["v"]
    found = dict(zip(equation.parameters, equation.constants, strict=True))
    assert found["g"].interval[0] < 7.0 < found["g"].interval[1]
    assert found["c"].interval[0] < 0.3 < found["c"].interval[1]


def test_an_unknown_part_is_found_and_shown_in_its_side():
    made = table(PENDULUM, ([2.0, 0.0],), TIMES, noise=0.01)
    pool = {"v": ("v", "-0.2*v", "theta", "-0.2*v - 0.01*theta")}
    refinement = refined(made, {"theta": "v", "v": "-g*sin(theta) + ?(v)"}, pool=pool, variables_of={"v": ("v",)})
    equation = refinement.equations["v"]
    assert equation.grade == "good"
    assert list(equation.unknowns) == ["?"]
    assert equation.parameters.count("g") == 1
    assert check(refinement, "v", "unknown part").outcome == "passed"


@pytest.mark.parametrize(
    ("sides", "parameters", "which"),
    [
        # the parameter and the unknown part may contain the same term
        ({"theta": "v", "v": "-7*sin(theta) - c*v + ?(v)"}, {}, "constants"),
        # the best value lies beyond the bound
        ({"theta": "v", "v": "-g*sin(theta) - 0.3*v"}, {"g": ParameterConfig(lower=8.0, upper=30.0)}, "constants"),
        # only the ratio is determined
        ({"theta": "v", "v": "-g/l*sin(theta) - 0.3*v"}, {}, "constants"),
        # nothing is missing
        ({"theta": "v", "v": "-7*sin(theta) - 0.3*v + ?"}, {}, "unknown part"),
        # the form is wrong
        ({"theta": "v", "v": "-g*theta - c*v"}, {}, "residual size"),
    ],
)
def test_what_the_data_do_not_support_is_never_good(sides, parameters, which):
    made = table(PENDULUM, ([2.0, 0.0],), TIMES, noise=0.01)
    pool = {"v": ("0.1*v", "0.01*theta", "0.01*v*v")} if "?" in sides["v"] else {}
    refinement = refined(made, sides, parameters, pool=pool)
    assert refinement.equations["v"].grade in ("doubtful", "no model")
    assert check(refinement, "v", which).outcome == "failed"


def test_a_wrong_given_form_is_called_the_likely_reason():
    made = table(PENDULUM, ([2.0, 0.0],), TIMES, noise=0.01)
    refinement = refined(made, {"theta": "v", "v": "-g*theta - c*v"})
    for equation in refinement.equations.values():
        assert "given term may be wrong" in equation.reason, equation.reason
        assert "easure more rows" not in equation.reason


def test_a_stopped_job_needs_time_and_no_other_terms():
    made, deadline = table(PENDULUM, ([2.0, 0.0],), TIMES, noise=0.01), Deadline()
    deadline.has_cut_short = True
    refinement = refined(made, {"theta": "v", "v": "-g*theta - c*v"}, deadline=deadline)
    for equation in refinement.equations.values():
        assert "Give more time" in equation.reason, equation.reason
        assert "given term may be wrong" not in equation.reason


def test_a_demanded_shape_is_no_evidence_for_an_unknown_part():
    made = table(PENDULUM, ([2.0, 0.0],), TIMES, noise=0.01)
    sides = {"theta": "v", "v": "-7*sin(theta) - 0.3*v + ?(v)"}  # nothing is missing
    refinement = refined(
        made, sides, pool={"v": ("0.01*v*v", "-0.01*v*v", "0.01*v**4")}, variables_of={"v": ("v",)},
        limits={"v": ("v -> inf: 1..1e30",)},
    )  # fmt: skip
    assert check(refinement, "v", "unknown part").outcome == "failed"


def test_a_hidden_state_follows_its_true_course():
    made = without(table(DRUG, ([10.0, 0.0],), DAYS, noise=0.01), "p")
    initial = {"p": ParameterConfig(start=0.0)}
    refinement = refined(made, DRUG_SIDES, RATES, data=HIDDEN, initial=initial)
    assert grades(refinement) == {"c": "good", "p": "good"}
    simulated = refinement.simulation.trajectories[0]
    truth = np.interp(simulated.times, DAYS, DRUG.values([10.0, 0.0], DAYS)[1])
    assert np.allclose(simulated.values["p"], truth, atol=0.03 * truth.max())
    assert check(refinement, "p", "hidden state").outcome == "passed"
    assert check(refinement, "c", "starting values").outcome == "passed"


def test_a_hidden_state_whose_scale_is_free_is_never_good():
    made = without(table(DRUG, ([10.0, 0.0],), DAYS, noise=0.01), "p")
    sides = {"c": "-0.8*c + b*p", "p": "s*c - 0.25*p"}  # only the product of b and s is determined
    parameters = {name: ParameterConfig(lower=0.01, upper=10.0) for name in "bs"}
    refinement = refined(made, sides, parameters, data=HIDDEN, initial={"p": ParameterConfig(start=0.0)})
    assert "good" not in grades(refinement).values()
    assert check(refinement, "p", "constants").outcome == "failed"


def absorbed(observed, parameters):
    """Return the refinement of a drug that is absorbed, of which a concentration is measured."""
    gut = Known(("g", "y"), lambda _, z: [-2.0 * z[0], 2.0 * z[0] - 0.4 * z[1]])
    made = without(table(gut, ([10.0, 0.0],), DAYS, noise=0.01), "g")
    data = DataConfig(hidden=("g", "c"), observe={"y": observed})
    initial = {"g": ParameterConfig(start=10.0), "c": ParameterConfig(start=0.0)}
    ranges = {name: ParameterConfig(lower=0.05, upper=20.0) for name in parameters}
    return refined(made, {"g": "-ka*g", "c": "ka*g - ke*c"}, ranges, data=data, initial=initial)


def test_a_second_solution_that_fits_as_well_is_never_good():
    refinement = absorbed("c/V", ("ka", "ke", "V"))  # ka and ke may be exchanged, with another volume
    assert set(grades(refinement).values()) == {"doubtful"}
    assert check(refinement, "c", "starting values").outcome == "failed"


def test_parameters_of_a_computed_column_are_checked():
    refinement = absorbed("a*c/b", ("ka", "ke", "a", "b"))  # only the ratio of a and b is determined
    assert set(grades(refinement).values()) == {"doubtful"}
    assert check(refinement, "g", "constants").outcome == "failed"


def test_a_velocity_that_was_not_measured_shows_a_friction_that_is_not_linear():
    """Van der Pol's equation: fits in which a linear function stands for the unknown part are far from the rows."""
    system = Known(("x", "v"), lambda _, z: [z[1], 1.2 * (1.0 - z[0] ** 2) * z[1] - z[0]])
    made = without(table(system, ([0.5, 0.0],), 0.05 * np.arange(300.0), noise=0.01), "v")
    refinement = refined(
        made, {"x": "v", "v": "-k*x + ?(x,v)"}, {"k": ParameterConfig(lower=0.1, upper=10.0)},
        data=DataConfig(hidden=("v",)), initial={"v": ParameterConfig(lower=-5.0, upper=5.0)},
        pool={"v": ("0.2*x", "v")}, variables_of={"v": ("x", "v")},
    )  # fmt: skip
    assert grades(refinement) == {"x": "good", "v": "good"}
    # the fits with a linear function ended at another k, which is no rival of the law that was found
    assert check(refinement, "v", "starting values").outcome == "passed"
    simulated = refinement.simulation.trajectories[0]
    truth = np.interp(simulated.times, 0.05 * np.arange(300.0), system.values([0.5, 0.0], 0.05 * np.arange(300.0))[1])
    assert np.allclose(simulated.values["v"], truth, atol=0.03 * truth.max())


def test_rows_with_weights_and_a_hidden_state_are_refined():
    made = without(table(PENDULUM, ([2.0, 0.0],), TIMES, noise=0.01), "v")
    weights = 1.0 + np.arange(len(TIMES)) % 2
    made = replace(made, names=(*made.names, "w"), units=(*made.units, ""), columns=np.vstack([made.columns, weights]))
    refinement = refined(
        made, {"theta": "v", "v": "-g*sin(theta) + ?(v)"}, {"g": ParameterConfig(lower=1.0, upper=30.0)},
        data=DataConfig(hidden=("v",), weights="w"), initial={"v": ParameterConfig(lower=-5.0, upper=5.0)},
        pool={"v": ("v", "-0.2*v")}, variables_of={"v": ("v",)},
    )  # fmt: skip
    assert grades(refinement) == {"theta": "good", "v": "good"}


def test_the_unit_of_a_hidden_state_changes_nothing():
    system = Known(("x", "v"), lambda _, z: [z[1], -4.0 * z[0] - 0.4 * z[1] * abs(z[1])])
    made = without(table(system, ([1.0, 0.5],), TIMES, noise=0.01), "v")
    prior = PriorConfig(
        equations={"x": "v", "v": "-k*x + ?(v)"}, parameters={"k": ParameterConfig(lower=0.1, upper=50)}
    )
    found = []
    for unit in (1.0, 1e-9, 1e9):
        columns = made.columns.copy()
        columns[1] *= unit
        config = JobConfig(prior=prior, data=DataConfig(hidden=("v",)), space=SpaceConfig(variables_of={"v": ("v",)}))
        preparation = prepare(replace(made, columns=columns), config)
        config = resolve_prior(config, preparation.dataset.variables, preparation.dataset.symbols)
        preparation = with_hidden_states(preparation, config)
        assert preparation.minima is not None
        assert preparation.minima.reached > 1, unit
        course = preparation.recording.trajectories[0].smoothed[1] / unit
        found.append([*preparation.parameters, *course.tolist()])
    assert np.allclose(found[1:], found[0], rtol=1e-4, atol=1e-4)


def test_clean_rows_of_a_wrong_law_with_a_hidden_state_are_simulated():
    system = Known(("x", "v"), lambda _, z: [z[1], -7.0 * np.sin(z[0]) - 0.4 * z[1] * abs(z[1])])
    made = without(table(system, ([2.0, 0.0],), TIMES), "v")
    bounds = {name: ParameterConfig(lower=0.01, upper=30.0) for name in "gc"}
    initial = {"v": ParameterConfig(lower=-5.0, upper=5.0)}
    refinement = refined(
        made, {"x": "v", "v": "-g*sin(x) - c*v"}, bounds, data=DataConfig(hidden=("v",)), initial=initial
    )
    assert set(grades(refinement).values()) == {"doubtful"}
    assert check(refinement, "x", "simulation").outcome == "passed"


RUNS = Known(("y", "k"), lambda _, z: [-z[1] * (z[0] - 0.5), 0.0])
RUN_TIMES = 0.1 * np.arange(50.0)
BY_RUN = {"k": ParameterConfig(lower=0.01, upper=10.0, by="run"), "b": ParameterConfig(lower=0.1, upper=10.0)}


def runs(*starts, sides=None, parameters=BY_RUN, **options):
    """Return the refinement of decays from 3 to 0.5 in several runs, each with a rate of its own."""
    made = without(table(RUNS, starts, RUN_TIMES, noise=0.01), "k")
    return refined(made, sides or {"y": "-k*(y - b)"}, parameters, **options)


def contain(values, truth):
    return [one.interval[0] < true < one.interval[1] for one, true in zip(values, truth, strict=True)]


def test_a_parameter_by_run_has_a_value_and_an_interval_in_each_run():
    rates = (0.2, 0.5, 1.0, 2.0)
    refinement = runs(*([3.0, rate] for rate in rates))
    assert grades(refinement) == {"y": "good", "k": "good"}
    values = refinement.equations["k"].runs
    assert [one.run for one in values] == ["1", "2", "3", "4"]
    assert all(contain(values, rates)), values
    assert not any(one.held_out or one.at_bound for one in values)


def test_an_equal_value_in_all_runs_is_determined():
    assert grades(runs([3.0, 0.7], [2.0, 0.7], [1.5, 0.7])) == {"y": "good", "k": "good"}


def test_an_unknown_part_is_found_beside_a_parameter_by_run():
    law = Known(("theta", "v", "l"), lambda _, z: [z[1], -9.81 / z[2] * np.sin(z[0]) - 0.3 * z[1], 0.0])
    made = without(table(law, ([1.0, 0.0, 0.5], [1.5, 0.0, 1.0]), TIMES, noise=0.01), "l")
    lengths = {"l": ParameterConfig(lower=0.1, upper=10.0, by="run")}
    pool = {"v": ("v", "-0.2*v", "theta", "-0.2*v - 0.01*theta")}
    refinement = refined(made, {"theta": "v", "v": "-9.81/l*sin(theta) + ?"}, lengths, pool=pool)
    assert grades(refinement) == {"theta": "good", "v": "good", "l": "good"}
    assert all(contain(refinement.equations["l"].runs, (0.5, 1.0)))


def test_a_run_that_does_not_determine_its_value_is_named_and_not_good():
    refinement = runs([3.0, 0.3], [3.0, 1.0], [0.5, 0.7])  # the third run begins where it ends
    assert set(grades(refinement).values()) == {"doubtful"}
    finding = check(refinement, "y", "constants")
    assert (finding.outcome, "run 3" in finding.reason, "k" in finding.reason) == ("failed", True, True)
    assert [one.identifiable for one in refinement.equations["k"].runs] == [True, True, False]


def test_a_value_beyond_its_bound_is_named_and_not_good():
    narrow = BY_RUN | {"k": ParameterConfig(lower=0.01, upper=0.8, by="run")}
    refinement = runs([3.0, 0.3], [3.0, 1.0], parameters=narrow)
    finding = check(refinement, "y", "constants")
    assert (finding.outcome, "run 2" in finding.reason) == ("failed", True)
    assert refinement.equations["k"].runs[1].at_bound


def test_the_value_of_a_held_out_run_is_fitted_to_this_run():
    refinement = runs([3.0, 0.3], [3.0, 1.0], [3.0, 6.0], data=DataConfig(holdout=1))
    assert grades(refinement) == {"y": "good", "k": "good"}
    values = refinement.equations["k"].runs
    assert [one.held_out for one in values] == [False, False, True]
    assert all(contain(values, (0.3, 1.0, 6.0))), values


def test_a_parameter_of_an_observed_column_may_differ_by_run():
    tank = Known(("y", "V"), lambda _, z: [(1.0 - 0.4 * z[0] * z[1]) / z[1], 0.0])  # y = c/V, dc/dt = 1 - 0.4*c
    made = without(table(tank, ([10.0, 1.0], [5.0, 2.0]), DAYS, noise=0.01), "V")
    parameters = {"V": ParameterConfig(lower=0.1, upper=10.0, by="run"), "a": ParameterConfig(lower=0.1, upper=10.0)}
    data = DataConfig(hidden=("c",), observe={"y": "c/V"})
    initial = {"c": ParameterConfig(start=10.0)}
    refinement = refined(made, {"c": "a - 0.4*c"}, parameters, data=data, initial=initial)
    assert all(contain(refinement.equations["V"].runs, (1.0, 2.0)))


def test_with_one_run_a_parameter_by_run_is_as_a_shared_one():
    by_run = runs([3.0, 0.7]).equations["k"].runs[0]
    shared = runs([3.0, 0.7], parameters=BY_RUN | {"k": ParameterConfig(lower=0.01, upper=10.0)}).equations["y"]
    found = dict(zip(shared.parameters, shared.constants, strict=True))["k"]
    assert by_run.fitted == pytest.approx(found.fitted, rel=2e-3)
    assert by_run.std_error == pytest.approx(found.std_error, rel=0.05)


def test_equal_seeds_give_equal_bits_with_hidden_states():
    made = without(table(DRUG, ([10.0, 0.0],), DAYS, noise=0.01), "p")
    first, second = (refined(made, DRUG_SIDES, RATES, data=HIDDEN) for _ in range(2))
    for name, equation in first.equations.items():
        assert equation.program.to_bytes() == second.equations[name].program.to_bytes()
