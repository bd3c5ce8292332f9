"""Figure 1 as a benchmark: sizes of solutions, random targets, and which runs are compared."""

import json

import numpy as np
import pytest

from atoll_core.expression.evaluation import values_of
from atoll_core.expression.operators import ADD, CONSTANT, DIVIDE, SIN, VARIABLE
from atoll_core.expression.simplification import complexity
from atoll_core.expression.text.parsing import from_infix
from atoll_island_worker.evolution.island import Island
from benchmarks.paper import figure1
from benchmarks.paper.archipelago import configured, problem_of
from benchmarks.paper.figure1_runs import (
    ARMS,
    FUNCTION,
    OPERATORS,
    Run,
    Task,
    bloats,
    by_size,
    curves,
    difference,
    looks_until,
    mean,
    pairs,
    run,
)
from benchmarks.paper.population import Population, population
from benchmarks.paper.random_targets import LEAST_SIZE, random_targets

X = np.linspace(-3.0, 3.0, 50)


def ended(arm, target=None, *, sizes=(5,), converged=100, target_size=4, seed=0):
    task = Task(arm, seed, target, 10, 100 * len(sizes), 20)
    looks = tuple(range(100, 100 * len(sizes) + 1, 100))
    return Run(task, looks, tuple(sizes), target_size, converged, 1000, None)


@pytest.fixture
def lists():
    """x + sin(x), with a dead constant; and x / 0.5, with two dead nodes."""
    return Population(
        code=np.array([[VARIABLE, CONSTANT, SIN, ADD], [VARIABLE, CONSTANT, SIN, DIVIDE]]),
        left=np.array([[0, 0, 0, 0], [0, 0, 1, 0]]),
        right=np.array([[0, 0, 1, 2], [0, 0, 1, 1]]),
        constants=np.array([[0.0, 7.0, 0.0, 0.0], [0.0, 0.5, 0.0, 0.0]]),
    )


def test_a_size_counts_live_nodes_only(lists):
    assert lists.sizes().tolist() == [3, 3]


def test_all_solutions_are_evaluated_at_once(lists):
    assert np.allclose(lists.values(X), [X + np.sin(X), X / 0.5])
    assert np.allclose(values_of(lists.program(0), X[np.newaxis]), X + np.sin(X))


def test_a_loss_is_infinite_where_a_value_is_not_finite(lists):
    lists.constants[1, 1] = 0.0
    losses = lists.losses(X, X)
    assert losses[0] == pytest.approx(np.abs(np.sin(X)).mean())
    assert losses[1] == np.inf


def test_the_solutions_of_an_island_are_those_it_would_send():
    island = Island(problem_of(X, X * X), configured("paper", 3, OPERATORS, 1e-300, islands=1), 0)
    island.advance(2)
    its = population(island)
    assert its.code.shape == (64, 32)
    least, best = its.losses(X, X * X).min(), island.outcome().best_error
    assert best is None or least <= best * (X * X).std() + 1e-12
    assert ((its.sizes() >= 1) & (its.sizes() <= 32)).all()


def test_random_targets_differ_vary_and_are_of_canonical_size():
    targets = random_targets(60, OPERATORS, X)
    assert len(set(targets)) == 60
    assert all(len(each) == complexity(each) >= LEAST_SIZE for each in targets)
    spreads = [float(values_of(each, X[np.newaxis]).std()) for each in targets]
    assert np.isfinite(spreads).all()
    assert min(spreads) >= 1e-2
    assert random_targets(20, OPERATORS, X) == targets[:20]


def test_targets_have_no_constants():
    assert not any((each.operators == CONSTANT).any() for each in random_targets(60, OPERATORS, X))


def test_a_run_is_looked_at_more_often_at_first_where_it_may_end():
    assert looks_until(400, False) == [100, 200, 300, 400]
    assert looks_until(400, True) == [*range(20, 201, 20), 300, 400]
    assert looks_until(50, True) == [20, 40, 50]


def test_the_arms_differ_only_in_what_measures_their_solutions():
    one, other = (run(Task(arm, 5, None, 1, 100, 60)) for arm in ARMS)
    assert one.target_size == other.target_size == complexity(from_infix(FUNCTION, ("x",)))
    assert one.looks == other.looks == (100,)
    assert one.evaluations < 0.5 * other.evaluations


def test_a_run_on_a_target_ends_when_it_is_exact_and_is_the_same_again():
    target = next(number for number, each in enumerate(random_targets(10, OPERATORS, X)) if len(each) == LEAST_SIZE)
    task = Task("predictors", 0, target, 10, 2000, 100)
    its = run(task)
    assert its.converged == its.looks[-1]
    assert its.bloat == its.sizes[-1] - LEAST_SIZE
    assert run(task) == its


def test_only_targets_that_both_arms_found_are_compared():
    runs = [ended(ARMS[0], 0, sizes=(6,)), ended(ARMS[1], 0, sizes=(9,)), ended(ARMS[0], 1), ended(ARMS[1], 2)]
    runs += [ended(ARMS[0], 3), ended(ARMS[1], 3, converged=None)]
    both = pairs(runs)
    assert [(one.task.target, other.task.target) for one, other in both] == [(0, 0)]
    assert [each.mean for each in bloats(both)] == [2.0, 5.0]
    assert list(by_size(both)) == [4]


def test_a_curve_is_the_mean_size_at_each_look():
    runs = [ended(ARMS[0], sizes=(4, 6)), ended(ARMS[0], sizes=(6, 8)), ended(ARMS[1], sizes=(9, 9))]
    its = curves(runs)
    assert [(each.mean, each.error) for each in its[ARMS[0]]] == [(5.0, 1.0), (7.0, 1.0)]
    assert [each.number for each in its[ARMS[1]]] == [1, 1]


def test_the_error_of_a_mean_is_its_standard_error():
    assert mean([1.0, 3.0]).error == pytest.approx(1.0)
    assert mean([2.0]).error is None
    assert difference([5, 7], [1, 1]).mean == 5.0


def test_numbers_file_and_picture_are_made_of_the_same_runs(monkeypatch, tmp_path, capsys):
    pytest.importorskip("matplotlib")

    def runs(_, tasks, __):
        return [ended(each.arm, each.target, sizes=(5, 8), seed=each.seed) for each in tasks]

    def task(arm, seed, target):
        return Task(arm, seed, target, 10, 200, 20)

    monkeypatch.setattr(figure1, "in_parallel", runs)
    asked = [task(arm, seed, target) for seed, target in ((0, None), (1, None), (0, 0), (0, 1)) for arm in ARMS]
    monkeypatch.setattr(figure1, "tasks", lambda _: asked)
    out, picture = tmp_path / "f.json", tmp_path / "f.png"
    assert figure1.main(["--out", str(out), "--picture", str(picture)]) == 0
    assert "both converged on 2" in capsys.readouterr().out
    written = json.loads(out.read_text("utf-8"))
    assert written["converged_in_both"] == 2
    assert written["looks"] == [100, 200]
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_one_run_of_each_arm_is_shown_without_an_error_of_the_mean(monkeypatch, capsys):
    runs = [ended(arm, target) for target in (None, 0) for arm in ARMS]
    monkeypatch.setattr(figure1, "tasks", lambda _: [each.task for each in runs])
    monkeypatch.setattr(figure1, "in_parallel", lambda *_: list(runs))
    assert figure1.main([]) == 0
    assert "nan" not in capsys.readouterr().out


def test_too_few_rows_for_predictors_are_refused(capsys):
    with pytest.raises(SystemExit) as ended_with:
        figure1.main(["--rows", "32"])
    assert ended_with.value.code == 2
    assert "give more than 32" in capsys.readouterr().err
