"""What follows from problem and configuration before an island begins."""

import pytest

from atoll_core.config import BudgetConfig, JobConfig
from atoll_core.data.dataset import EXACT_ERROR, Target
from atoll_island_worker.evolution.setup import UNREACHABLE_TARGET, island_share, target_error


def target(floor=0.0, noise=0.0):
    return Target("x", "dx/dt", None, floor, 1.0, noise)


@pytest.mark.parametrize(
    ("runners_up", "islands", "share"), [(0, 8, 0), (1, 8, 1), (5, 8, 2), (8, 8, 2), (8, 4, 4), (8, 1, 8), (64, 8, 16)]
)
def test_islands_share_the_runners_up_and_keep_twice_as_many_together(runners_up, islands, share):
    assert island_share(runners_up, islands) == share
    assert min(runners_up, 2 * runners_up // islands) <= share <= runners_up


def test_a_clean_target_s_search_ends_where_it_has_converged_and_a_noisy_one_s_nowhere():
    assert target_error(JobConfig(), target()) == EXACT_ERROR
    assert target_error(JobConfig(), target(floor=1e-4)) == 2e-4
    assert target_error(JobConfig(), target(floor=1e-3)) == UNREACHABLE_TARGET < 0.0
    assert target_error(JobConfig(), target(noise=0.01)) == UNREACHABLE_TARGET


def test_what_a_user_asks_for_ends_every_search():
    config = JobConfig(budget=BudgetConfig(target_error=0.2))
    assert target_error(config, target()) == target_error(config, target(floor=0.3, noise=0.1)) == 0.2
