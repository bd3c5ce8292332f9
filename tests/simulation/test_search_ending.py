"""The cut against its definition: all islands computed in full, and then picked out what counts."""

import hashlib
from collections.abc import Iterator
from typing import Any

import pytest

from atoll_coordinator.service.jobs.job import commit_order_of
from atoll_core.config import BudgetConfig, EvolutionConfig, JobConfig, MigrationConfig
from atoll_core.search.commit_order import CommitOrder, Position
from atoll_core.search.pareto import FrontEntry, merge
from atoll_core.wire.messages.epochs import IslandReport
from atoll_island_worker.session.interface import EpochTask, TaskKey
from tests.simulation.bus.fault_plan import Plan
from tests.simulation.harness.simulated_cluster import World
from tests.simulation.harness.stub_islands import Shuffle, StubIsland, StubWork, hits_of, parse_slots

SEEDS = range(10)
EPOCHS = 4
RUNNERS_UP = 2


@pytest.fixture(autouse=True)
def early_hits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.simulation.harness.stub_islands.HIT_EPOCHS", EPOCHS - 1)


def config(seed: int, joining: int | None, islands: int = 5) -> JobConfig:
    return JobConfig(
        seed=seed,
        evolution=EvolutionConfig(islands=islands, runners_up=RUNNERS_UP),
        migration=MigrationConfig(joining=joining),
        budget=BudgetConfig(max_epochs=EPOCHS, stagnation=1000),
    )


def reports_of(config: JobConfig, variable: str, epochs: int) -> Iterator[list[IslandReport]]:
    """Yield for each epoch the reports of all islands, every one computed to the epoch's end or to its hit."""
    order, islands = commit_order_of(config), config.evolution.islands
    seeds = (f"{config.seed}/{variable}/{island}".encode() for island in range(islands))
    states = [StubIsland(hashlib.sha256(seed).digest()) for seed in seeds]
    for epoch in range(epochs):
        works = [
            StubWork(
                EpochTask(TaskKey("job", variable, 1, island, epoch), None, False, order), state, config, lambda: None
            )
            for island, state in enumerate(states)
        ]
        for work in works:
            while not work.advance():
                pass
        yield [work.computed().report for work in works]
        shuffle = Shuffle.of(config, variable, epoch)
        sent = [shuffle.blocks_from(island, state.state) for island, state in enumerate(states)]
        for island, state in enumerate(states):
            slots = parse_slots({source: blocks[island] for source, blocks in enumerate(sent) if island in blocks})
            state.stir(*(slots[slot] for slot in sorted(slots)))


def first_hit(config: JobConfig, variable: str) -> Position | None:
    reachable = (hit for hit in hits_of(config, variable) if hit.epoch < EPOCHS)
    return min(reachable, key=commit_order_of(config).rank, default=None)


def counted(commit_order: CommitOrder, at: Position, hit: Position | None) -> bool:
    return hit is None or commit_order.rank(at) <= commit_order.rank(hit)


def definition(config: JobConfig, variable: str) -> dict[str, Any]:
    """Return what the result must say of one equation."""
    hit, commit_order = first_hit(config, variable), commit_order_of(config)
    epochs = EPOCHS if hit is None else hit.epoch + 1
    evaluations: dict[int, dict[str, int]] = {}
    entries: list[FrontEntry] = []
    for epoch, reports in enumerate(reports_of(config, variable, epochs)):
        for report in reports:
            for tally in report.counters:
                if counted(commit_order, Position(epoch, tally.generation, report.island), hit):
                    evaluations[report.island] = dict(tally.evaluations)
            entries += [
                FrontEntry(one.complexity, one.error, one.mse, epoch, one.generation, report.island, one.program)
                for one in report.additions
                if counted(commit_order, Position(epoch, one.generation, report.island), hit)
            ]
    return {
        "epoch": epochs,
        "generation": None if hit is None else 100 * hit.epoch + hit.generation,
        "points": sum(sum(evaluation.values()) for evaluation in evaluations.values()),
        "errors": [entry.error for entry in merge((), entries)][
            -1:
        ],  # made-up islands report constants alone: one function
    }


def answered(result: dict[str, Any], variable: str) -> dict[str, Any]:
    (equation,) = (equation for equation in result["equations"] if equation["variable"] == variable)
    return {
        "epoch": equation["epoch"],
        "generation": equation["generation"] if equation["why"] == "target" else None,
        "points": equation["point_evaluations"],
        "errors": [member["error"] for member in equation["front"]],
    }


@pytest.mark.parametrize(
    ("joining", "seeds"),
    [
        (2, SEEDS[:4]),
        pytest.param(2, SEEDS[4:], marks=pytest.mark.slow),
        pytest.param(None, SEEDS, marks=pytest.mark.slow),
    ],
)
def test_the_answer_is_what_the_definition_says(joining: int | None, seeds: range) -> None:
    for seed in seeds:
        ours = config(seed, joining)
        worlds = [World(workers=1, seed=seed), World(workers=3, seed=seed, plan=Plan(drop=0.05, late=0.1))]
        answers = [world.run(ours) for world in worlds]
        for variable in ("x", "y"):
            expected = definition(ours, variable)
            assert [answered(answer, variable) for answer in answers] == [expected] * 2, (seed, variable)
        assert answers[0]["digest"] == answers[1]["digest"]


@pytest.mark.slow
def test_runners_up_take_part_in_the_digest() -> None:
    digests = set()
    for most in (0, 1, RUNNERS_UP):
        ours = config(3, None)
        ours = ours.model_copy(update={"evolution": ours.evolution.model_copy(update={"runners_up": most})})
        digests.add(World(workers=2, seed=3).run(ours)["digest"])
    assert len(digests) == 3


@pytest.mark.slow
def test_one_worker_computes_nothing_beyond_the_cut() -> None:
    for seed in SEEDS:
        world, ours = World(workers=1, seed=seed), config(seed, 2)
        world.run(ours, "x")
        hit, commit_order = first_hit(ours, "x"), commit_order_of(ours)
        ends = [
            Position(epoch, tally.generation, report.island)
            for epoch, reports in enumerate(reports_of(ours, "x", EPOCHS if hit is None else hit.epoch + 1))
            for report in reports
            for tally in report.counters
        ]
        assert world.computes["w0"].turns == sum(counted(commit_order, at, hit) for at in ends)


@pytest.mark.parametrize("seeds", [SEEDS[:4], SEEDS])
def test_hits_come_early_late_several_at_once_and_never(seeds: range) -> None:
    """The seeds above tell something."""
    hits = [hits_of(config(seed, None), variable) for seed in seeds for variable in ("x", "y")]
    assert any(not hit for hit in hits)
    assert any(len(hit) > 1 for hit in hits)
    assert {0, 1} <= {min(at.epoch for at in hit) for hit in hits if hit}
