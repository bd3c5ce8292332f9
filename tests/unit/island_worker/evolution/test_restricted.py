"""What enters a front is kept to bounds on constants and to required variables."""

import numpy as np
import pytest

from atoll_core.config import BudgetConfig, EvolutionConfig, JobConfig, PredictorConfig, PriorConfig, SpaceConfig
from atoll_core.data.dataset import Problem, Target
from atoll_core.expression.program import Program
from atoll_core.expression.shapes import read_shapes, shape_points
from atoll_core.expression.text.infix import to_infix
from atoll_island_worker.evolution.island import Island

NAMES = ("x", "y")


def searched(bounds=(), required=(), truth=lambda x, y: 3.0 * x - 2.0 * x * y, shapes=()):
    number = np.arange(60)
    x, y = 0.5 + number * 37 % 41 / 20.0, 0.25 + number * 29 % 43 / 25.0
    values = truth(x, y)
    config = JobConfig(
        space=SpaceConfig(terminals=7, operators=("+", "-", "*"), required_of={"x": required} if required else {}),
        prior=PriorConfig(bounds={"x": bounds} if bounds else {}, monotone={"x": shapes} if shapes else {}),
        evolution=EvolutionConfig(islands=1, population=32, runners_up=4),
        predictors=PredictorConfig(rows=16),
        budget=BudgetConfig(target_error=1e-9),
    )
    island = Island(Problem(NAMES, np.stack([x, y]), Target("x", "dx/dt", values, 0.0, float(values.std()))), config, 0)
    while not island.advance(50):
        pass
    report = island.report()
    programs = [Program.from_bytes(entry.program, 2) for entry in (*report.additions, *report.runners_up)]
    return programs, report, (x, y, values)


def test_a_bound_that_excludes_the_best_constants_is_kept_by_all_that_is_reported():
    from atoll_core.expression.restrictions import EquationBounds, parse_bound

    texts = ("x < 2", "x*y > -1")
    bounds = EquationBounds(tuple(parse_bound(text, NAMES) for text in texts))
    programs, report, _ = searched(texts)
    assert programs
    assert all(bounds.are_kept(program) for program in programs)
    assert report.hit is None
    assert any(governed.is_active for program in programs for governed in bounds.governed(program))
    free, unbounded, _ = searched()
    assert unbounded.hit is not None
    assert not all(bounds.are_kept(program) for program in free)


def test_constants_are_fitted_within_their_bounds():
    _, report, (x, y, values) = searched(("x*y > -1",))
    best = {to_infix(Program.from_bytes(entry.program, 2), NAMES): entry.error for entry in report.additions}
    a = np.linalg.lstsq(x[:, None], values + x * y, rcond=None)[0][0]  # the best factor of x beside -1 of x*y
    sizes = [error for text, error in best.items() if "1.0*x*y" in text and "**" not in text]
    assert sizes
    assert min(sizes) <= 1.05 * float(np.mean(np.abs(values + x * y - a * x)))


def test_what_lacks_a_required_variable_stands_on_no_front():
    programs, *_ = searched(required=("y",), truth=lambda x, _: 2.0 * x)
    assert programs
    assert all(1 in program.left[program.operators == 0] for program in programs)


@pytest.mark.parametrize("bounds", [("|c| < 100",), ("y > 3", "y < 5")])
def test_a_bound_that_the_best_constants_keep_changes_nothing(bounds):
    programs, report, _ = searched(bounds)
    assert report.hit is not None
    assert programs


@pytest.mark.parametrize("bounds", [(), ("x < 4",)])
def test_what_leaves_a_demanded_shape_stands_on_no_front(bounds):
    """The truth, 3*x - 2*x*y, is increasing in x for small y only."""
    programs, report, (x, y, _) = searched(bounds, shapes=("increasing in x",))
    shapes, points = read_shapes(["increasing in x"], NAMES, ""), shape_points(np.stack([x, y]))
    assert report.hit is None
    assert programs
    assert all(shapes.are_kept(program, points) for program in programs)
    free, *_ = searched(bounds)
    assert not all(shapes.are_kept(program, points) for program in free)


def test_a_shape_that_the_law_has_does_not_hinder_the_search():
    _, report, _ = searched(shapes=("increasing in x",), truth=lambda x, y: 3.0 * x + x * y)
    assert report.hit is not None
