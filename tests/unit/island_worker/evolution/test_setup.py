"""What follows from problem and configuration before an island begins."""

import gc
import weakref
from dataclasses import replace

import numpy as np

from atoll_core.config import JobConfig, PredictorConfig, SpaceConfig
from atoll_core.data.dataset import EXACT_ERROR, Problem, Target
from atoll_island_worker.evolution.setup import UNREACHABLE_TARGET, IslandSetup, target_error
from atoll_island_worker.evolution.structures import CACHE_LINE, MOST_TERMS, empty_lists, empty_rows, empty_scratch


def target(floor=0.0, noise=0.0):
    return Target("x", "dx/dt", None, floor, 1.0, noise)


def test_a_clean_target_s_search_ends_where_it_has_converged_and_a_noisy_one_s_nowhere():
    assert target_error(JobConfig(), target()) == EXACT_ERROR
    assert target_error(JobConfig(), target(floor=1e-4)) == 2e-4
    assert target_error(JobConfig(), target(floor=1e-3)) == UNREACHABLE_TARGET < 0.0
    assert target_error(JobConfig(), target(noise=0.01)) == UNREACHABLE_TARGET


def test_arrays_that_kernels_load_as_vectors_begin_at_cache_lines():
    scratch, rows = empty_scratch(6, 37, 3, 16, 50), empty_rows(3, 50, 6)
    arrays = [*empty_lists(6, 37), scratch.signature, rows.inputs, rows.waves, rows.target, rows.mask, rows.centred]
    for work in (scratch.near, scratch.work):
        arrays += [work.values, work.adjoints, work.basis, work.columns, work.residual]
    assert {array.ctypes.data % CACHE_LINE for array in arrays} == {0}
    assert all(not array.any() for array in arrays if array is not rows.mask and array.shape != (6, 1 + MOST_TERMS))


def problem():
    values = np.arange(12.0)
    return Problem(("x", "y"), np.stack([values, values**2]), Target("x", "dx/dt", values, 0.0, 1.0))


def config():
    fields = {"space": SpaceConfig(terminals=7), "predictors": PredictorConfig(rows=4)}
    return JobConfig(**fields)


def test_islands_of_one_problem_share_its_rows_and_others_do_not():
    one, settings = problem(), config()
    first, second = (IslandSetup(one, settings, island) for island in range(2))
    assert first.equation is second.equation
    assert first.rows is not second.rows
    assert IslandSetup(problem(), settings, 0).equation is not first.equation
    assert IslandSetup(one, config(), 0).equation is not first.equation


def test_groups_have_rows_of_their_own_which_their_islands_share():
    grouped, settings = replace(problem(), groups=np.arange(12) % 2), config()
    setups = [IslandSetup(grouped, settings, island) for island in range(4)]
    assert setups[0].equation is setups[2].equation
    assert setups[1].equation is setups[3].equation
    assert setups[0].every.target[0, :6].tolist() == [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
    assert setups[1].every.target[0, :6].tolist() == [1.0, 3.0, 5.0, 7.0, 9.0, 11.0]


def test_a_setup_is_forgotten_with_its_problem():
    one = problem()
    equation = weakref.ref(IslandSetup(one, config(), 0).equation)
    del one
    gc.collect()
    assert equation() is None
