"""What follows from problem and configuration before an island begins."""

from atoll_core.config import JobConfig
from atoll_core.data.dataset import EXACT_ERROR, Target
from atoll_island_worker.evolution.setup import UNREACHABLE_TARGET, target_error


def target(floor=0.0, noise=0.0):
    return Target("x", "dx/dt", None, floor, 1.0, noise)


def test_a_clean_target_s_search_ends_where_it_has_converged_and_a_noisy_one_s_nowhere():
    assert target_error(JobConfig(), target()) == EXACT_ERROR
    assert target_error(JobConfig(), target(floor=1e-4)) == 2e-4
    assert target_error(JobConfig(), target(floor=1e-3)) == UNREACHABLE_TARGET < 0.0
    assert target_error(JobConfig(), target(noise=0.01)) == UNREACHABLE_TARGET
