"""Systems fitted and compared over the same measurements."""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.data.reading.files import read_table
from atoll_coordinator.model.batches import Spread
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.description_length import structure_length
from atoll_coordinator.model.selection import comparison
from atoll_coordinator.model.selection.candidates import CandidateSet
from atoll_coordinator.model.selection.comparison import Constraints, FitPlan, FitStart, ModelComparison
from atoll_coordinator.model.selection.grouped_rows import GroupedRows
from atoll_coordinator.model.selection.joint_search import exchange_programs, find_starting_system
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.selection.task import ModellingTask
from atoll_coordinator.model.shooting.fit_result import bounded_covariance, covariance
from atoll_coordinator.model.shooting.measurements import measurements_of
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.settings import SETTINGS, EffortSettings
from atoll_core.config import DataConfig, JobConfig, PriorConfig
from atoll_core.data.dataset import Dataset
from atoll_core.data.table import Table
from atoll_core.expression.program import Program, structure
from atoll_core.expression.restrictions import restrictions_of
from atoll_core.expression.text.parsing import from_infix
from atoll_core.wire.values import encode_value
from tests.batches import ScatteredBatches
from tests.unit.coordinator.model.shooting.made import (
    DECAY,
    LOTKA,
    LOTKA_TEXT,
    SWING,
    Known,
    compare,
    measurements,
    recording,
    table,
)

EXAMPLES = Path(__file__).parents[5] / "examples"
TIMES = 0.1 * np.arange(40.0)
STARTS = ([1.0, 3.0], [4.0, 1.0], [3.0, 3.0])
NOISE = 0.02
TRUTH, OTHER = (LOTKA.parsed(text) for text in LOTKA_TEXT)
RIVALS = tuple(
    map(
        LOTKA.parsed,
        ("1.1*x - 0.9*x*x", "2.9*x - 2.1*x*y - 0.9*x*x", "1.5 - 0.3*y - 0.5*x", "2.0 - 0.7*x", "exp(9.0*x)"),
    )
)

NEAR = ("2.9*x - 2.1*x*y + 0.1*y", "2.9*x - 2.1*x*y*y/(0.5 + y)", "2.9*x - 1.2*x*y*x", "2.9*x - 1.5*y*x + 0.3*sin(y)")
"""Systems that can be simulated from the initial states of the truth."""


class FewKept(EffortSettings):
    """Two programs are kept at a time."""

    @property
    def kept(self) -> int:
        return 2


def lotka(noise=NOISE, deadline=None, **options) -> ModelComparison:
    measured = measurements(LOTKA, STARTS, TIMES, noise=noise)
    return ModelComparison(MultipleShooting(measured, 1e-6, deadline), LOTKA.names, **options)


def test_a_standing_has_the_nats_of_misfit_programs_and_constants():
    comparison = lotka()
    model = comparison.fit_model([TRUTH, OTHER])
    assert model is not None
    squares = (model.fit.residuals**2).mean(axis=1)
    misfit = 0.5 * 120 * float(np.log(squares).sum())
    assert model.misfit == pytest.approx(misfit)
    programs = structure_length(TRUTH) + structure_length(OTHER)
    assert model.nats == pytest.approx(misfit + programs + 0.5 * math.log(120) * len(model.fit.system.places))
    assert model.fit.segments.tolist() == [[0, 40], [40, 80], [80, 120]]


def test_programs_come_back_with_fitted_constants():
    model = lotka().fit_model([RIVALS[1], OTHER])
    assert model is not None
    assert structure(model.programs[0]) == structure(RIVALS[1])
    constants = np.abs(model.programs[0].constants[model.programs[0].operators == 1])
    assert sorted(constants.tolist()) == pytest.approx([1.0, 2.0, 3.0], abs=0.1)


def test_the_truth_has_the_shortest_description():
    comparison = lotka()
    models = comparison.fit_all([(program, OTHER) for program in (*RIVALS, TRUTH)])
    assert structure(models[0].programs[0]) == structure(TRUTH)
    assert [model.nats for model in models] == sorted(model.nats for model in models)
    assert len(models) == len(RIVALS)  # the exponential cannot be simulated


def test_residuals_smaller_than_rounding_errors_gain_nothing():
    times = np.linspace(0.0, 20.0, 300)
    states = np.round([np.cos(times), -np.sin(times)])
    rows = np.arange(300, dtype=np.int64)
    rounded = Table(("t", "x", "v"), ("",) * 3, np.array([times, *states]), (0,), ("a.csv",), 0 * rows, rows + 2, ())
    measured = measurements_of(prepare(rounded, JobConfig()).recording, [0, 1])
    misfit = compare(SWING, measured).score.misfit
    assert (
        misfit.total(np.array([0.07, 0.005]))
        == misfit.total(np.array([0.07, 0.05]))
        < misfit.total(np.array([0.07, 0.2]))
    )
    unrounded = compare(SWING, replace(measured, rounding=None)).score.misfit
    assert unrounded.total(np.array([0.07, 0.005])) < unrounded.total(np.array([0.07, 0.05])) - 10.0


def test_what_cannot_be_simulated_has_no_standing():
    assert lotka().fit_model([RIVALS[-1], OTHER]) is None
    near = lotka().fit_model([TRUTH, OTHER])
    assert lotka().fit_replacement(near, 0, RIVALS[-1], 5) is None


def test_an_exchange_leaves_the_other_equations_structure():
    comparison = lotka()
    near = comparison.fit_model([TRUTH, OTHER])
    other = comparison.fit_replacement(near, 0, RIVALS[0], 20)
    assert structure(other.programs[0]) == structure(RIVALS[0])
    assert structure(other.programs[1]) == structure(OTHER)
    assert other.nats > near.nats


def test_halving_keeps_the_best_and_notes_them():
    comparison = lotka()
    near = comparison.fit_model([RIVALS[2], OTHER])
    models = comparison.narrow_down(near, 0, [*RIVALS, TRUTH], ((4, 3), (20, 2)))
    assert structure(models[0].programs[0]) == structure(TRUTH)
    assert len(models) <= 2
    assert comparison.fitted_models == {(0, structure(model.programs[0])): model for model in models}


def test_only_fits_that_stay_above_the_limit_end_before_they_have_converged():
    """The limit changes no fit that can reach it, and saves work of the other fits."""
    free, limited = lotka(), lotka()
    near = limited.fit_model([TRUTH, OTHER])
    plan = FitPlan(40, near=FitStart(near.fit.starts, near.fit.errors, False))
    work = []
    for program in (*RIVALS[:-1], *map(LOTKA.parsed, NEAR), TRUTH):
        (whole, most), (ended, least) = (
            comparison.fit_and_summarize((each, (program, OTHER)))
            for comparison, each in ((free, plan), (limited, replace(plan, limit=near.nats + 8.0)))
        )
        if whole is None or whole.nats <= near.nats + 8.0:
            assert encode_value(ended) == encode_value(whole)
        else:
            assert ended.nats >= whole.nats > near.nats + 8.0
            assert least <= most
            work.append((least, most))
    assert len(work) >= 3
    assert sum(least for least, _ in work) < 0.8 * sum(most for _, most in work)


def test_beyond_the_work_that_is_allowed_no_more_programs_are_taken_in(monkeypatch):
    monkeypatch.setattr(comparison, "SETTINGS", replace(SETTINGS, effort=FewKept()))
    lotka_comparison = lotka()
    near = lotka_comparison.fit_model([RIVALS[2], OTHER])
    programs = [RIVALS[0], RIVALS[3], TRUTH]
    models = lotka_comparison.narrow_down(near, 0, programs, ((4, 3),), until=lotka_comparison.estimator.work)
    assert {structure(model.programs[0]) for model in models} == {structure(program) for program in programs[:2]}
    assert len(lotka_comparison.narrow_down(near, 0, programs, ((4, 3),))) == 3


def test_of_programs_that_say_the_same_the_shortest_stays():
    comparison = lotka()
    near = comparison.fit_model([TRUTH, OTHER])
    words = [LOTKA.parsed(text) for text in ("x/(1.0/(2.9 - 2.1*y - 0.9*x))", "x*(2.9 - 2.1*y - 0.9*x)")]
    models = comparison.narrow_down(near, 0, [*words, RIVALS[1]], ((20, 5),))
    assert [structure(model.programs[0]) for model in models] == [structure(words[1])]


def test_only_a_shorter_description_replaces_what_was_noted():
    comparison = lotka()
    near = comparison.fit_model([TRUTH, OTHER])
    comparison.narrow_down(near, 0, [RIVALS[0]], ((30, 1),))
    (best,) = comparison.fitted_models.values()
    comparison.narrow_down(near, 0, [RIVALS[0]], ((0, 1),))
    assert comparison.fitted_models == {(0, structure(RIVALS[0])): best}


def test_models_of_one_function_differ_in_misfit():
    comparison, program = lotka(), TRUTH

    def kept(*standings: tuple[float, float]) -> list[float]:
        models = [FittedModel((program,), None, misfit, nats) for misfit, nats in standings]
        return [model.nats for model in comparison.distinct_models(models, 0)]

    assert kept((-100.0, 1.0), (-100.0 - 1e-5, 2.0), (-99.0, 3.0), (-99.0, 4.0)) == [1.0, 3.0]
    near = [(-99.0 + 1.01e-4 * step, float(step)) for step in range(-3, 4)]
    assert kept(*near) == [-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0]
    nearer = [(-99.0 + 0.99e-4 * step, float(step)) for step in range(-3, 4)]
    assert kept(*nearer) == [-3.0, -1.0, 1.0, 3.0]


def test_models_of_one_misfit_that_differ_beside_the_curve_are_two():
    """Of two that grow alike x is y wherever it was measured; half of the sum is the same beside it as well."""
    alike = Known(("x", "y"), lambda _, z: [z[0] * (1.0 - z[0]), z[1] * (1.0 - z[1])])
    comparison = compare(alike, measurements(alike, [[0.1, 0.1]], 0.1 * np.arange(60.0)))
    near = comparison.fit_model([alike.parsed("x*(1.0 - x)"), alike.parsed("y*(1.0 - y)")])
    texts = ("x*(1.0 - x)", "x - 1.0*x*x", "y*(1.0 - x)")
    models = comparison.narrow_down(near, 0, [alike.parsed(text) for text in texts], ((40, 5),))
    assert {structure(model.programs[0]) for model in models} == {
        structure(alike.parsed(texts[place])) for place in (0, 2)
    }
    state = comparison.disputed_state(models[0], models[1:], 0)
    assert abs(state["x"] - state["y"]) > 0.1


def test_constants_of_a_fixed_equation_stay():
    comparison = lotka(fixed=[1])
    known = LOTKA.parsed("2.02*y - x*y - y**2")
    model = comparison.fit_model([RIVALS[1], known])
    assert model.programs[1] == known
    assert len(model.fit.system.places) == 3
    assert model.programs[0] != RIVALS[1]


def test_held_nodes_of_a_program_stay():
    comparison = lotka()
    held = range(len(TRUTH)), ()
    system = comparison.system([TRUTH, OTHER], held)
    assert set(system.owners.tolist()) == {1}


def narrowed(fitting: ModelComparison, until: float = math.inf) -> tuple[list[bytes], int]:
    """Return models of narrowed down programs to the bit, and the work that was counted; the best ones are whole."""
    near = fitting.fit_model([RIVALS[0], OTHER])
    models = fitting.narrow_down(near, 0, [*RIVALS, TRUTH], ((4, 4), (10, 3)), until)
    models += fitting.fit_all([(program, OTHER) for program in RIVALS], 6, (5,))
    fitting, calibrated = fitting.calibrate(models[0])
    models += [calibrated, *fitting.narrow_down(calibrated, 1, [*RIVALS, OTHER], ((2, 9),), until)]
    models += fitting.fit_all([(program, OTHER) for program in RIVALS])
    return [bits(model) for model in models], fitting.estimator.work


def bits(model: FittedModel) -> bytes:
    fit = model.fit
    arrays = (
        fit.system.constants, fit.system.places, fit.segments, fit.starts, fit.simulated, fit.residuals,
        fit.errors.sigmas, fit.squares, fit.blocks.normal, fit.blocks.coupling, fit.blocks.own, fit.blocks.gradient,
        np.array([model.misfit, model.nats, fit.is_stiff]),
    )  # fmt: skip
    assert fit.system.programs[-len(model.programs) :] == model.programs
    return b"".join(b"" if array is None else array.tobytes() for array in arrays)


@pytest.mark.parametrize("threads", [1, 4])
def test_the_number_of_threads_changes_no_bit(threads):
    with ThreadPoolExecutor(threads) as executor:
        assert narrowed(lotka(spread=Spread(None, executor))) == narrowed(lotka())


@pytest.mark.parametrize("workers", [1, 2, 3, 7])
def test_neither_workers_nor_their_order_change_a_bit_or_the_work_that_is_counted(workers, monkeypatch):
    monkeypatch.setattr(comparison, "SETTINGS", replace(SETTINGS, effort=FewKept()))
    batches = ScatteredBatches(workers)
    for until in (math.inf, 1.0):
        assert narrowed(lotka(spread=Spread(batches)), until) == narrowed(lotka(), until)
    assert {function for function, _ in batches.calls} == {"fits"}
    assert max(count for _, count in batches.calls) > 1
    assert len(batches.contexts) <= 4, "of each run one before and one after errors are calibrated"
    assert batches.compared >= 2 * len(RIVALS), "people are told of all that were compared"


def test_what_time_has_cut_short_is_left_out():
    deadline = Deadline(1000.0)
    late = lotka(spread=Spread(ScatteredBatches(2, is_over=True), deadline=deadline), deadline=deadline)
    assert late.fit_all([(program, OTHER) for program in RIVALS]) == []
    assert late.estimator.deadline.has_cut_short
    assert late.estimator.work == 0


def prepared(noise: float) -> Dataset:
    return prepare(table(LOTKA, STARTS, TIMES, noise), JobConfig()).dataset


def test_batches_of_groups_and_bounds_change_no_bit():
    measured = measurements(LOTKA, ([1.0, 3.0], [4.0, 1.0]), 0.1 * np.arange(30.0), noise=0.02)
    measured = replace(measured, groups=np.arange(2))
    problems = [[prepared(0.02).problem(name)] * 2 for name in LOTKA.names]
    restrictions = {0: restrictions_of(JobConfig(prior=PriorConfig(bounds={"x": ("c < 2.5",)})), "x", LOTKA.names)}

    def run(spread: Spread) -> list[bytes]:
        constraints = Constraints(restrictions, GroupedRows(2, problems, restrictions))
        fitting = compare(LOTKA, measured, constraints=constraints, spread=spread)
        near = fitting.fit_model([RIVALS[0], OTHER])
        return list(map(bits, fitting.narrow_down(near, 0, [*RIVALS, TRUTH], ((4, 4),))))

    assert run(Spread(ScatteredBatches(3))) == run(Spread())


def test_a_model_that_leaves_a_demanded_shape_is_none_here_and_on_workers():
    measured = measurements(LOTKA, STARTS, TIMES, noise=0.02)
    inputs, x = prepared(0.02).inputs, "x"
    config = JobConfig(prior=PriorConfig(monotone={x: ("increasing in y",)}))
    constraints = Constraints({0: restrictions_of(config, x, LOTKA.names, inputs)})
    kept = LOTKA.parsed("x*(1 - 0.5*x)")

    def run(spread: Spread) -> list[bytes]:
        fitting = compare(LOTKA, measured, constraints=constraints, spread=spread)
        assert fitting.fit_model([TRUTH, OTHER]) is None
        near = fitting.fit_model([kept, OTHER])
        assert near is not None
        assert fitting.fit_from(near, [TRUTH, OTHER]) is None
        models = fitting.fit_all([(program, OTHER) for program in (TRUTH, kept, *RIVALS)])
        assert all(fitting.restrictions(0).has_shapes(model.programs[0]) for model in models)
        return list(map(bits, models))

    found = run(Spread())
    assert found
    assert run(Spread(ScatteredBatches(3))) == found
    assert compare(LOTKA, measured).fit_model([TRUTH, OTHER]) is not None


def test_noise_is_not_exact_and_its_absence_is():
    assert not lotka().score.is_exact(lotka().fit_model([TRUTH, OTHER]))
    comparison = compare(LOTKA, measurements(LOTKA, STARTS, TIMES), 1e-10)
    assert comparison.score.is_exact(comparison.fit_model([TRUTH, OTHER]))
    assert not comparison.score.is_exact(comparison.fit_model([RIVALS[0], OTHER]))


def test_the_state_with_the_largest_share_of_integration_errors_decides():
    score = lotka().score
    model = FittedModel((), SimpleNamespace(squares=score.least_errors**2 / [4.0, 0.25]), 0.0, 0.0)
    assert score.integration_error_factor(model) == pytest.approx(4.0)


def test_the_covariance_is_that_of_least_squares():
    """x' = -a x from a fitted start: two columns, in closed form."""
    rows = measurements(DECAY, [[2.0]], TIMES, noise=0.01)
    fit = MultipleShooting(rows, 1e-10).fit(compare(DECAY, rows).system([DECAY.parsed("-0.5*x")]), None, 30)
    rate, start = abs(float(fit.system.values[0])), float(fit.starts[0, 0])
    decay = np.exp(-rate * TIMES)
    columns = np.stack([TIMES * start * decay, decay], axis=1) / fit.errors.sigmas[0]
    assert covariance(fit)[0, 0] == pytest.approx(np.linalg.inv(columns.T @ columns)[0, 0], rel=1e-5)


def test_constants_that_only_count_together_have_infinite_variances():
    rows = measurements(DECAY, [[2.0]], TIMES, noise=0.01)
    made = compare(DECAY, rows).system([from_infix("-0.2*x - 0.3*x", DECAY.names)])
    fit = MultipleShooting(rows, 1e-8).fit(made, None, 10)
    assert np.isinf(np.diag(covariance(fit))).all()
    assert np.isfinite(covariance(fit)[0, 1])
    bounded = bounded_covariance(fit)
    assert (np.linalg.eigvalsh(bounded) > 0.0).all()


def test_a_constant_beside_redundant_ones_keeps_its_variance():
    rows = measurements(LOTKA, STARTS, TIMES, noise=NOISE)
    made = compare(LOTKA, rows).system([from_infix("2.2*x + 0.7*x - 2.1*x*y - 0.9*x*x", LOTKA.names), OTHER])
    fit = MultipleShooting(rows, 1e-8).fit(made, None, 10)
    variances = np.diag(covariance(fit)).tolist()
    assert len(variances) == len(made.places) > 3
    assert np.isinf(variances).tolist() == [True, True, *[False] * (len(variances) - 2)]


def calibrated(comparison: ModelComparison, *programs: Program) -> tuple[ModelComparison, FittedModel]:
    model = comparison.fit_model(list(programs), 40)
    assert model is not None
    return comparison.calibrate(model)


def has_room(comparison: ModelComparison, *programs: Program) -> bool:
    comparison, model = calibrated(comparison, *programs)
    return comparison.score.may_be_improved(model)


def long_lotka(noise: float, seed: int = 0) -> ModelComparison:
    return compare(LOTKA, measurements(LOTKA, STARTS, 0.05 * np.arange(150.0), noise=noise, seed=seed), 1e-10)


@pytest.mark.parametrize("seed", [1, 3])
def test_where_noise_alone_is_left_no_longer_system_is_worth_looking_for(seed):
    comparison = long_lotka(NOISE, seed)
    assert not has_room(comparison, TRUTH, OTHER)


def test_what_is_left_beyond_noise_gives_room_for_a_longer_system():
    comparison = long_lotka(NOISE, 1)
    assert has_room(comparison, LOTKA.parsed("1.1*x - 0.9*x*y"), OTHER)


def test_without_noise_only_errors_of_integration_leave_no_room():
    comparison = long_lotka(0.0)
    assert not has_room(comparison, TRUTH, OTHER)
    assert has_room(comparison, LOTKA.parsed("1.1*x - 0.9*x*y"), OTHER)


@pytest.mark.parametrize("size", [1.2e-4, 3e-4])
def test_of_a_nearly_clean_state_beside_a_noisy_one_noise_leaves_no_room(size):
    rows = measurements(LOTKA, STARTS, 0.05 * np.arange(150.0), noise=NOISE, seed=3)
    errors = size * np.random.default_rng(1).standard_normal(rows.rows)
    clean = np.array([rows.scales[0] * size, rows.noise[1]])
    exact = measurements(LOTKA, STARTS, 0.05 * np.arange(150.0)).measured[0]
    measured = np.stack([exact + rows.scales[0] * errors, rows.measured[1]])
    comparison = compare(LOTKA, replace(rows, measured=measured, noise=clean), 1e-10)
    assert not has_room(comparison, TRUTH, OTHER)
    assert has_room(comparison, LOTKA.parsed("1.1*x - 0.9*x*y"), OTHER)


@pytest.mark.parametrize("taken", [1e-5, 1e-2])
def test_what_a_clean_state_is_missed_by_leaves_room_whatever_noise_the_smoother_takes_it_to_have(taken):
    times = 0.05 * np.arange(150.0)
    rows = measurements(LOTKA, STARTS, times)
    missed = 1e-3 * rows.scales[0] * np.sin(np.tile(times, len(STARTS)))
    measured = rows.measured + np.array([missed, np.zeros(rows.rows)])
    noise = taken * rows.scales[rows.observed]
    comparison = compare(LOTKA, replace(rows, measured=measured, noise=noise), 1e-10)
    assert has_room(comparison, TRUTH, OTHER)


def test_outliers_leave_no_room():
    """Two rows have errors of eight times the size: the variance of the noise is known badly."""
    rows = measurements(LOTKA, STARTS, 0.05 * np.arange(150.0), noise=NOISE, seed=3)
    measured = rows.measured.copy()
    measured[1, [40, 260]] += 8.0 * rows.noise[1]
    comparison = compare(LOTKA, replace(rows, measured=measured), 1e-10)
    comparison, model = calibrated(comparison, TRUTH, OTHER)
    assert model.fit.squares[1] > 1.25 * rows.noise[1] ** 2
    assert not comparison.score.may_be_improved(model)
    assert has_room(comparison, LOTKA.parsed("1.1*x - 0.9*x*y"), OTHER)


def test_what_is_missed_in_a_few_rows_is_no_outlier():
    """Rows beside each other are off to one side, as where a short pulse of an input is not in the law."""
    rows = measurements(LOTKA, STARTS, 0.05 * np.arange(150.0), noise=NOISE, seed=3)
    measured = rows.measured.copy()
    measured[1, 40:55] += 3.5 * rows.noise[1]
    measured[1, 260:275] += 3.5 * rows.noise[1]
    comparison = compare(LOTKA, replace(rows, measured=measured), 1e-10)
    assert has_room(comparison, TRUTH, OTHER)


def test_an_absent_species_must_stay_absent():
    """Along the second trajectory x is 0 throughout: an equation with a constant term would bring it in."""
    times = 0.1 * np.arange(40.0)
    recorded = recording(LOTKA, ([1.0, 3.0], [0.0, 1.0]), times, noise=0.02, seed=4)
    recorded.trajectories[1].measured[0], recorded.trajectories[1].smoothed[0] = 0.0, 0.0
    comparison = compare(LOTKA, measurements_of(recorded, [0, 1]), 1e-8)
    truth, wrong = (
        comparison.fit_model([LOTKA.parsed(text), LOTKA.parsed("2.0*y - x*y - y*y")], lengths=(10, None))
        for text in ("3.0*x - 2.0*x*y - x*x", "3.0*x - 2.0*x*y - x*x + 0.001")
    )
    assert np.abs(truth.fit.simulated[0, 40:]).max() == 0.0
    assert truth.fit.starts[1, 0] == wrong.fit.starts[1, 0] == 0.0
    assert wrong.nats > truth.nats + 20.0


def test_what_the_equations_miss_is_not_taken_for_errors_that_go_together():
    """Hares and lynxes: with errors that are a random walk, constants leave half of the deviation unexplained."""
    config = JobConfig(data=DataConfig(time="year"))
    preparation = prepare(read_table([EXAMPLES / "lynx_hare.csv"], config.data), config)
    states = ("hare", "lynx")
    task = ModellingTask(preparation.dataset, preparation.recording, config, dict.fromkeys(states, CandidateSet()))
    comparison = task.make_comparison(task.measurements(states), states)
    names = preparation.dataset.names
    programs = [from_infix(text, names) for text in ("hare*(0.5 - 0.025*lynx)", "0.025*lynx*(hare - 33.0)")]
    comparison, _ = comparison.calibrate(comparison.fit_model(programs))
    assert comparison.score.errors is None


def drifting(true, length=300):
    """Return a comparison over one decay whose sensor has errors that go together, and the fitted system of `true`."""
    rng = np.random.default_rng(3)
    rows = measurements(DECAY, ([4.0],), 0.1 * np.arange(float(length)), noise=NOISE)
    walk = np.zeros(length)
    for row in range(1, length):
        walk[row] = 0.9 * walk[row - 1] + NOISE * rng.standard_normal()
    comparison = compare(DECAY, replace(rows, measured=rows.measured + walk))
    return comparison, comparison.fit_model([DECAY.parsed(true)])


def test_errors_of_a_sensor_are_held_for_all_systems():
    comparison, begun = drifting("-0.4*x")
    assert (
        comparison.score.excess(begun)
        <= 1.25
        < np.sqrt(begun.fit.squares[0]) / comparison.estimator.measurements.noise[0]
    )
    comparison, model = comparison.calibrate(begun)
    assert comparison.score.errors is not None
    assert comparison.score.errors.shares[0] > 0.5
    assert model.fit.errors.decays.tolist() == comparison.score.errors.decays.tolist()
    white = comparison.score.whiten(model.fit)[0]
    assert abs(float(white[1:] @ white[:-1]) / float(white @ white)) < 0.15
    assert not comparison.score.may_be_improved(model)
    longer = comparison.fit_replacement(model, 0, DECAY.parsed("0.01 - 0.4*x"), 40)
    assert longer.fit.errors.shares.tolist() == comparison.score.errors.shares.tolist()
    assert longer.nats > model.nats + 4.0
    assert comparison.score.inflation(model) == pytest.approx(1.0, abs=0.1)
    anew = comparison.fit_model([DECAY.parsed("-0.4*x")])
    assert anew.fit.errors.shares.tolist() == comparison.score.errors.shares.tolist()
    assert anew.nats == pytest.approx(model.nats, abs=0.01)


def test_errors_are_calibrated_anew_whatever_errors_were_held_before():
    wrong = "1.0 - 0.4*x*x"
    comparison, begun = drifting("-0.4*x")
    comparison, _ = comparison.calibrate(begun)
    after, fitted_after = comparison.calibrate(comparison.fit_model([DECAY.parsed(wrong)]))
    fresh, begun = drifting(wrong)
    fresh, fitted = fresh.calibrate(begun)
    assert fitted_after.fit.system.values == pytest.approx(fitted.fit.system.values, rel=1e-2)
    assert after.score.roughness == pytest.approx(fresh.score.roughness, rel=1e-3)


def test_what_a_law_misses_is_no_error_of_a_sensor():
    comparison, wrong = drifting("1.0 - 0.4*x*x")
    comparison, model = comparison.calibrate(wrong)
    assert comparison.score.errors is None
    assert comparison.score.excess(model) > 1.25


@pytest.mark.parametrize("begun", [(TRUTH, OTHER), (RIVALS[1], LOTKA.parsed("1.0*y - 0.5*y*y"))])
def test_equations_exchanged_as_if_the_best_stayed_the_same_are_those_exchanged_in_turn(begun):
    ends = []
    for spread in (Spread(), Spread(ScatteredBatches(3))):
        comparison = lotka(spread=spread)
        comparison, model = comparison.calibrate(comparison.fit_model(begun))
        best = exchange_programs(comparison, model, [[TRUTH, *RIVALS], [OTHER, LOTKA.parsed("1.0*y - 0.5*y*y")]])
        ends.append(
            (
                best.nats,
                encode_value(best.programs, tuple[Program, ...]),
                comparison.estimator.work,
                len(comparison.fitted_models),
            )
        )
    assert ends[0] == ends[1]


def test_nothing_is_foreseen_of_one_equation_or_where_nobody_takes_batches():
    for made, equations in ((lotka(), (0, 1)), (lotka(spread=Spread(ScatteredBatches(3))), (0,))):
        near = made.fit_model([TRUTH, OTHER])
        assert made.prefetch_models(near, {equation: [TRUTH] for equation in equations}, ((6, 1),)) == {}


@pytest.mark.parametrize(("input_error", "wins"), [(0.0, 1), (0.02, 0)])
def test_what_the_curve_of_an_input_hides_makes_no_equation_longer(input_error, wins):
    """A term that moves the state by 0.1 % is seen, unless inputs between rows are less certain than that."""
    known = Known(("x",), lambda _, z: [0.002 * z[0] ** 2 - 0.5 * z[0]])
    measured = replace(measurements(known, [[1.0], [2.0]], TIMES, noise=0.0), input_error=input_error)
    compared = ModelComparison(MultipleShooting(measured, 1e-8), DECAY.names)
    models = [compared.fit_model([DECAY.parsed(text)], 20) for text in ("-0.5*x", "0.002*x*x - 0.5*x")]
    assert min(range(2), key=lambda place: models[place].nats) == wins


def test_the_unit_of_a_state_changes_neither_the_fit_nor_the_errors_of_constants():
    """Competitors, one counted in units of 1e-8: the same residuals and errors over the sizes."""
    found = []
    for unit in (1.0, 1e8):
        known = Known(("x", "y"), lambda t, z, unit=unit: np.array([unit, 1.0]) * LOTKA.rates(t, [z[0] / unit, z[1]]))
        texts = (f"3.1*x - 2.1*x*y - {1.1 / unit!r}*x*x", f"1.9*y - {1.1 / unit!r}*x*y - 0.9*y*y")
        measured = measurements(known, [[unit * x, y] for x, y in STARTS], TIMES, noise=(NOISE * unit, NOISE))
        compared = ModelComparison(MultipleShooting(measured, 1e-8), known.names)
        model = compared.fit_model([known.parsed(text) for text in texts], 30)
        errors = np.sqrt(np.diag(covariance(model.fit))) / np.abs(model.fit.system.values)
        found.append((np.sqrt(model.fit.squares) / measured.scales, errors))
    for one, other in zip(*found, strict=True):
        assert other == pytest.approx(one, rel=1e-3)


@dataclass(frozen=True, eq=False)
class Failing(ModelComparison):
    """A comparison in which some systems cannot be fitted, depending on whether the segments are `short` only."""

    short: bool = False
    except_for: bytes = b""

    def fit_all(
        self, systems: Sequence[Sequence[Program]], steps: int = 1, lengths: Sequence[int | None] = comparison.STAGES
    ) -> list[FittedModel]:
        models = super().fit_all(systems, steps, lengths)
        if self.short != (len(lengths) == 1):
            return models
        return [model for model in models if structure(model.programs[0]) == self.except_for]


@pytest.mark.parametrize("short", [False, True])
def test_a_system_outside_of_the_best_in_short_segments_is_found_if_these_cannot_be_simulated(short: bool) -> None:
    best = [DECAY.parsed(f"-{0.1 * rank}*x") for rank in range(1, 7)]
    last = DECAY.parsed("0.1 - 0.2*x*x*x")
    estimator = MultipleShooting(measurements(DECAY, [[1.0], [2.0]], 0.2 * np.arange(60.0)), 1e-6)
    left = structure(last) if not short else b""
    found = find_starting_system(Failing(estimator, DECAY.names, short=short, except_for=left), [[*best[:4], last]])
    assert found is not None
    assert structure(found.programs[0]) == structure(last if not short else best[0])


def test_a_system_that_was_found_before_is_a_starting_system() -> None:
    law = DECAY.parsed("-0.5*x")
    estimator = MultipleShooting(measurements(DECAY, [[1.0], [2.0]], 0.2 * np.arange(60.0)), 1e-6)
    comparison, others = ModelComparison(estimator, DECAY.names), [[DECAY.parsed("0.1 - 0.2*x*x*x")]]
    without, found = find_starting_system(comparison, others), find_starting_system(comparison, others, known=[law])
    assert without is not None
    assert found is not None
    assert structure(found.programs[0]) == structure(law)
    assert found.nats < without.nats
