"""All islands of one variable in one process, without bus or coordinator: epochs, reshuffles, the first hit."""

from dataclasses import dataclass

from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset, Problem
from atoll_core.search.pareto import FrontEntry, merge
from atoll_island_worker.evolution.island import EpochOutcome, Island


@dataclass(frozen=True)
class Search:
    """What a search came to: all reports, the merged front, and whether the target was met."""

    outcomes: tuple[EpochOutcome, ...]
    front: tuple[FrontEntry, ...]
    has_hit: bool

    @property
    def digests(self) -> list[str]:
        """Digests of all islands at the end of every epoch."""
        return [outcome.digest for outcome in self.outcomes]


def advance(island: Island, stride: int = 10) -> EpochOutcome:
    """Advance `island` to the end of its epoch, or to its hit, `stride` generations at a time."""
    while not island.advance(stride):
        pass
    return island.outcome()


def reshuffle(islands: list[Island]) -> None:
    """Give every island the immigrants of the epoch that has ended."""
    sent = [island.emigrants() for island in islands]
    for number, island in enumerate(islands):
        sources = island.senders() | {number}
        island.immigrate({source: sent[source][number] for source in sources if number in sent[source]})


def search(problem: Problem, config: JobConfig, epochs: int, stride: int = 10) -> Search:
    """Search for one equation for at most `epochs` epochs; ends with the epoch in which an island met the target."""
    islands = [Island(problem, config, number) for number in range(config.evolution.islands)]
    outcomes: list[EpochOutcome] = []
    for epoch in range(epochs):
        ended = [advance(island, stride) for island in islands]
        outcomes += ended
        if any(outcome.hit for outcome in ended) or epoch == epochs - 1:
            break
        reshuffle(islands)
    front = merge((), (entry for outcome in outcomes for entry in outcome.additions))
    return Search(tuple(outcomes), front, any(outcome.hit for outcome in ended))


def search_all(dataset: Dataset, config: JobConfig, epochs: int) -> list[Search]:
    """Search for every equation of `dataset`."""
    return [search(dataset.problem(variable), config, epochs) for variable in dataset.variables]
