"""An island's epoch is a pure function of its state, its immigrants, the problem, the configuration and the seed."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from atoll_core.config import (
    BudgetConfig,
    EvolutionConfig,
    JobConfig,
    MigrationConfig,
    PredictorConfig,
    SpaceConfig,
)
from atoll_core.data.dataset import Problem, Target
from atoll_core.errors import LocalProtocolError, RemoteProtocolError
from atoll_core.expression.program import Program
from atoll_core.expression.simplification import complexity
from atoll_core.wire.codec import decode_arrays, encode_arrays
from atoll_island_worker.evolution.island import Island, reshuffle_without_blocks
from atoll_island_worker.evolution.setup import IslandSetup
from tests.archipelago import advance, reshuffle, search
from tests.oracles import fitting
from tests.oracles.tapes import node_values

ROOT = Path(__file__).resolve().parents[4]


def problem_of(rows=60, truth=None):
    """Return a problem over two variables; by default one that no equation of the space solves."""
    number = np.arange(rows)
    x, y = 0.5 + number * 37 % 41 / 20.0, 0.25 + number * 29 % 43 / 25.0
    values = np.sqrt(x * y + 1.0) / (x + y) if truth is None else truth(x, y)
    return Problem(("x", "y"), np.stack([x, y]), Target("x", "dx/dt", values, 0.0, float(values.std())))


def config_of(seed=3, islands=2, population=16, generations=30, rows=8, **changes):
    fields = {
        "seed": seed,
        "space": SpaceConfig(terminals=7),
        "evolution": EvolutionConfig(islands=islands, population=population),
        "predictors": PredictorConfig(rows=rows, effort=0.2, renewal=5),
        "migration": MigrationConfig(generations=generations),
        "budget": BudgetConfig(target_error=1e-300),
    }
    return JobConfig(**{**fields, **changes})


PROBLEM, CONFIG = problem_of(), config_of()


def run(config=CONFIG, problem=PROBLEM, epochs=2, stride=10):
    return search(problem, config, epochs, stride)


def test_the_same_seed_gives_the_same_answer_and_another_seed_another():
    assert run() == run()
    assert not set(run().digests) & set(run(config_of(seed=4)).digests)


@pytest.mark.parametrize("stride", [1, 7, 100])
def test_it_does_not_matter_in_how_many_steps_an_epoch_is_done(stride):
    assert run(stride=stride) == run(stride=10)


@pytest.mark.parametrize("stride", [1, 10])
def test_islands_that_take_turns_within_an_epoch_know_nothing_of_each_other(stride):
    """They share scratch arrays, in which nothing may be left that another's next generations depend on."""
    islands = [Island(PROBLEM, CONFIG, number) for number in range(2)]
    waiting = list(islands)
    while waiting:
        waiting = [island for island in waiting if not island.advance(stride)]
    assert [island.report() for island in islands] == list(run(epochs=1).reports)


def test_islands_of_one_process_are_reshuffled_as_by_blocks():
    by_blocks, at_once = ([Island(PROBLEM, CONFIG, number) for number in range(2)] for _ in range(2))
    for islands in (by_blocks, at_once):
        for island in islands:
            while not island.advance():
                pass
    reshuffle(by_blocks)
    reshuffle_without_blocks(at_once)
    assert [island.to_bytes() for island in at_once] == [island.to_bytes() for island in by_blocks]


@pytest.mark.parametrize("preset", ["default", "paper"])
@pytest.mark.parametrize("is_predicted", [True, False])
def test_an_island_written_and_read_between_epochs_goes_on_with_the_same_bits(preset, is_predicted):
    """All that can influence later bits or counters is in its bytes."""
    evolution = EvolutionConfig(islands=2, population=16)
    if preset == "paper":
        evolution = evolution.model_copy(update={"constant_fit_steps": 0, "linear_terms": 0, "scaled_constants": False})
    config = config_of(evolution=evolution, preset=preset, predictors=PredictorConfig(rows=8, enabled=is_predicted))
    islands = [Island(PROBLEM, config, number) for number in range(2)]
    for _ in range(3):
        islands = [Island.from_bytes(island.to_bytes(), PROBLEM, config, k) for k, island in enumerate(islands)]
        ended = [advance(island) for island in islands]
        reshuffle(islands)
    assert tuple(ended) == run(config, epochs=3).reports[-2:]


@pytest.mark.parametrize("is_predicted", [True, False])
def test_an_island_written_and_read_before_its_immigrants_come_goes_on_with_the_same_bits(is_predicted):
    config = config_of(islands=2, predictors=PredictorConfig(rows=8, enabled=is_predicted))
    islands = [Island(PROBLEM, config, number) for number in range(2)]
    for _ in range(3):
        ended = [advance(island) for island in islands]
        data = [island.to_bytes() for island in islands]
        islands = [Island.from_bytes(one, PROBLEM, config, k) for k, one in enumerate(data)]
        assert [island.to_bytes() for island in islands] == data
        reshuffle(islands)
    assert tuple(ended) == run(config, epochs=3).reports[-2:]


def test_an_island_is_not_written_within_an_epoch():
    island = Island(PROBLEM, CONFIG, 0)
    island.advance(10)
    with pytest.raises(LocalProtocolError):
        island.to_bytes()


NEAR = config_of(evolution=EvolutionConfig(islands=2, population=16, runners_up=3), generations=50)


def test_runners_up_are_part_of_an_island_that_is_written_and_read():
    islands = [Island(PROBLEM, NEAR, number) for number in range(2)]
    for _ in range(3):
        islands = [Island.from_bytes(island.to_bytes(), PROBLEM, NEAR, k) for k, island in enumerate(islands)]
        ended = [advance(island) for island in islands]
        reshuffle(islands)
    assert tuple(ended) == run(NEAR, epochs=3).reports[-2:]
    assert any(report.runners_up for report in ended)


@pytest.mark.parametrize(("noise", "floor"), [(0.1, 0.0), (0.0, 0.05)])
def test_nothing_but_an_explicit_target_error_ends_the_search_for_a_noisy_target(noise, floor):
    clean = problem_of(truth=lambda x, y: x * y)
    noisy = Problem(clean.names, clean.inputs, replace(clean.target, noise=noise, uncertainty=floor))
    budget = BudgetConfig()
    assert run(config_of(budget=budget), clean).has_hit
    assert not run(config_of(budget=budget), noisy).has_hit
    assert run(config_of(budget=BudgetConfig(target_error=0.2)), noisy).has_hit


def test_bytes_are_the_same_after_reading_and_writing():
    island = Island(PROBLEM, CONFIG, 0)
    other = Island(PROBLEM, CONFIG, 1)
    for one in (island, other):
        advance(one)
    reshuffle([island, other])
    data = island.to_bytes()
    assert Island.from_bytes(data, PROBLEM, CONFIG, 0).to_bytes() == data


def without(data, name):
    header, arrays = decode_arrays(data)
    return encode_arrays(header, {key: array for key, array in arrays.items() if key != name})


def with_array(data, name, array):
    header, arrays = decode_arrays(data)
    return encode_arrays(header, {**arrays, name: array})


@pytest.mark.parametrize(
    "spoil",
    [
        lambda data: b"",
        lambda data: data[:-1],
        lambda data: without(data, "fitness"),
        lambda data: with_array(data, "fitness", np.zeros(3)),
        lambda data: with_array(data, "fitness", np.zeros(1)),
        lambda data: with_array(data, "list code", np.full((16, 32), 99, np.int8)),
        lambda data: with_array(data, "trainer left", np.full((8, 32), 31, np.int32)),
        lambda data: with_array(data, "predictors", np.full((8, 8), 60, np.int64)),
        lambda data: with_array(data, "best", np.array([8])),
        lambda data: encode_arrays({}, decode_arrays(data)[1]),
        lambda data: encode_arrays({"epoch": 1, "front": [[1, 2]]}, decode_arrays(data)[1]),
    ],
)
def test_a_state_that_does_not_fit_is_refused(spoil):
    island = Island(PROBLEM, config_of(islands=1), 0)
    advance(island)
    reshuffle([island])
    with pytest.raises(RemoteProtocolError):
        Island.from_bytes(spoil(island.to_bytes()), PROBLEM, config_of(islands=1), 0)


def test_an_island_that_refused_immigrants_is_unchanged():
    islands = [Island(PROBLEM, CONFIG, number) for number in range(2)]
    for island in islands:
        advance(island)
    sent = [island.emigrants() for island in islands]
    before, report = islands[0].emigrants(), islands[0].report()
    for blocks in ({}, {0: sent[0][0]}, {0: sent[0][0], 1: b"x"}, {0: sent[0][0], 1: sent[0][0]}):
        with pytest.raises(RemoteProtocolError):
            islands[0].immigrate(blocks)
        assert islands[0].epoch == 0
        assert islands[0].emigrants() == before
        assert islands[0].report() == report
    reshuffle(islands)
    assert advance(islands[0]) == run().reports[2]


@pytest.mark.parametrize("loss", ["mae", "rmse"])
def test_every_addition_was_measured_on_all_rows(loss):
    config = config_of(evolution=EvolutionConfig(islands=2, population=16, loss=loss))
    additions = [entry for report in run(config).reports for entry in report.additions]
    assert len(additions) > 5
    for entry in additions:
        program = Program.from_bytes(entry.program, 2)
        with np.errstate(all="ignore"):
            absolute, squared = fitting.errors(node_values(program, PROBLEM.inputs)[-1], PROBLEM.target.values)
        assert entry.complexity == complexity(program)
        assert entry.mse == pytest.approx(squared, rel=1e-12)
        assert entry.error == pytest.approx(absolute if loss == "mae" else squared**0.5, rel=1e-12)


def test_additions_improve_the_island_s_own_front_in_the_order_they_were_found():
    for number in range(2):
        front = []
        for report in run(epochs=3).reports[number::2]:
            for entry in report.additions:
                assert all(entry.error < earlier.error for earlier in front if earlier.complexity <= entry.complexity)
                front.append(entry)
            assert report.best_error == pytest.approx(min(e.error for e in front) / PROBLEM.target.standard_deviation)


def test_operators_are_in_the_order_of_their_codes_and_unknown_ones_refused():
    config = config_of(space=SpaceConfig(operators=("cos", "+", "sin", "+"), terminals=7))
    assert IslandSetup(problem_of(), config, 0).space.operators.tolist() == [2, 6, 7]
    with pytest.raises(KeyError):
        IslandSetup(problem_of(), config_of(space=SpaceConfig(operators=("+", "gamma"), terminals=7)), 0)


def test_who_sends_is_who_is_waited_for():
    config = config_of(islands=6, population=4, generations=1)
    islands = [Island(problem_of(), config, number) for number in range(6)]
    for island in islands:
        advance(island)
    sent = [island.emigrants() for island in islands]
    for number, island in enumerate(islands):
        assert island.senders() == {other for other in range(6) if other != number and number in sent[other]}


def test_an_epoch_that_is_given_up_can_be_reported():
    whole, part = (Island(problem_of(), config_of(), 0) for _ in range(2))
    advance(whole)
    part.advance(10)
    given_up, report = part.report(), whole.report()
    assert (given_up.generations, given_up.hit) == (10, None)
    assert given_up.additions == tuple(entry for entry in report.additions if entry.generation <= 10)
    assert given_up.counters == report.counters[:1]


def test_an_island_that_meets_the_target_stops_there():
    problem = problem_of(truth=lambda x, y: 3.0 * x - x * x - 2.0 * x * y)
    config = config_of(population=64, generations=100, rows=16, budget=BudgetConfig(target_error=1e-9))
    result = search(problem, config, 20)
    assert result.has_hit
    hit = next(report for report in result.reports if report.hit)
    assert hit.hit.error <= 1e-9
    assert hit.hit.generation == hit.generations
    assert hit.best_error == hit.hit.error
    assert result.front[-1].error <= 1e-9 * problem.target.standard_deviation


TINY = """
import numpy, sys
numpy.seterr(all="ignore")
from tests.unit.island_worker.evolution.test_island import config_of, run
sys.stdout.write(" ".join(run(config_of(population=8, generations=5)).digests))
"""


def test_interpreted_kernels_give_the_bits_of_the_compiled_ones():
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    finished = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", TINY], cwd=ROOT, env=environment, capture_output=True, text=True
    )
    assert finished.returncode == 0, finished.stderr
    assert finished.stdout.split() == run(config_of(population=8, generations=5)).digests
