"""All islands of one variable in one process, without bus or coordinator: epochs, reshuffles, the first hit."""

from dataclasses import dataclass

from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset, Problem
from atoll_core.search.pareto import FrontEntry, merge
from atoll_core.wire.messages.epochs import IslandReport
from atoll_island_worker.evolution.island import Island


@dataclass(frozen=True)
class Search:
    """What a search came to: all reports, the merged front, and whether the target was met."""

    reports: tuple[IslandReport, ...]
    front: tuple[FrontEntry, ...]
    has_hit: bool

    @property
    def digests(self) -> list[str]:
        """Digests of all islands at the end of every epoch."""
        return [report.digest for report in self.reports]


def advance(island: Island, stride: int = 10) -> IslandReport:
    """Advance `island` to the end of its epoch, or to its hit, `stride` generations at a time."""
    while not island.advance(stride):
        pass
    return island.report()


def reshuffle(islands: list[Island]) -> None:
    """Give every island the immigrants of the epoch that has ended."""
    sent = [island.emigrants() for island in islands]
    for number, island in enumerate(islands):
        sources = island.senders() | {number}
        island.immigrate({source: sent[source][number] for source in sources if number in sent[source]})


def search(problem: Problem, config: JobConfig, epochs: int, stride: int = 10) -> Search:
    """Search for one equation for at most `epochs` epochs; ends with the epoch in which an island met the target."""
    islands = [Island(problem, config, number) for number in range(config.evolution.islands)]
    reports: list[IslandReport] = []
    additions: list[FrontEntry] = []
    for epoch in range(epochs):
        ended = [advance(island, stride) for island in islands]
        reports += ended
        additions += [entry for island in islands for entry in island.additions()]
        if any(report.hit for report in ended) or epoch == epochs - 1:
            break
        reshuffle(islands)
    return Search(tuple(reports), merge((), additions), any(report.hit for report in ended))


def search_all(dataset: Dataset, config: JobConfig, epochs: int) -> list[Search]:
    """Search for every equation of `dataset`."""
    return [search(dataset.problem(variable), config, epochs) for variable in dataset.variables]
