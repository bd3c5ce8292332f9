"""What a worker keeps of one archipelago for those who may ask: emigrants, reports and snapshots. Pure.

Emigrants and reports are kept until every island has reported their epoch, snapshots until a later checkpoint, or their
own, is durable at the coordinator.
"""

from collections.abc import Collection, Iterable, Mapping
from typing import Final

from atoll_core.wire.messages.epochs import (
    Block,
    EpochReport,
    IslandReport,
    Migrants,
    NotYet,
    PullMigrants,
    PullReports,
    PullStates,
    Reports,
    States,
)
from atoll_core.wire.messages.workers import Placement
from atoll_core.wire.state_pieces import IslandState, split_states

ADDITIONS_PER_ANSWER: Final = 20_000
"""An answer with reports ends after this many additions to the front; the rest is asked for again."""


class RetransmitBuffer:
    """What the islands `islands` of one worker have sent, reported and been, under one term."""

    def __init__(self, placement: Placement, islands: Collection[int]) -> None:
        self._placement = placement
        self._islands = islands
        self._sent: dict[tuple[int, int], dict[int, bytes]] = {}
        self._reports: dict[int, dict[int, IslandReport]] = {}
        self._snapshots: dict[int, dict[int, IslandState]] = {}

    def keep_emigrants(self, epoch: int, island: int, emigrants: Mapping[int, bytes]) -> None:
        """Keep what an island sends, by destination."""
        self._sent[epoch, island] = dict(emigrants)

    def keep_report(self, epoch: int, report: IslandReport) -> None:
        """Keep what an island says of an epoch."""
        self._reports.setdefault(epoch, {})[report.island] = report

    def keep_snapshot(self, epoch: int, island: int, data: bytes) -> None:
        """Keep the state of an island at a checkpoint."""
        self._snapshots.setdefault(epoch, {})[island] = IslandState.of(data)

    def reporters(self, epoch: int) -> Collection[int]:
        """Return the islands whose reports of an epoch are kept."""
        return self._reports.get(epoch, {}).keys()

    def snapshots(self) -> tuple[int, ...]:
        """Return the epochs of which every island has a snapshot."""
        return tuple(sorted(epoch for epoch, states in self._snapshots.items() if len(states) == len(self._islands)))

    def epochs_sent(self) -> Iterable[int]:
        """Return the epochs of which emigrants are kept."""
        return (epoch for epoch, _ in self._sent)

    def forget(self, reported: int, commit: int) -> None:
        """Forget what was sent and reported in epochs below `reported`, and snapshots up to `commit`."""
        self._sent = {key: blocks for key, blocks in self._sent.items() if key[0] >= reported}
        self._reports = {epoch: reports for epoch, reports in self._reports.items() if epoch >= reported}
        self._snapshots = {epoch: states for epoch, states in self._snapshots.items() if epoch > commit}

    def report(self, epoch: int) -> EpochReport:
        """Return the report of one epoch, islands in order."""
        placed, kept = self._placement, self._reports[epoch]
        islands = tuple(kept[island] for island in sorted(kept))
        return EpochReport(job=placed.job, variable=placed.variable, term=placed.term, epoch=epoch, islands=islands)

    def migrants(self, epoch: int, blocks: Iterable[Block]) -> Migrants:
        """Return a message with blocks of one epoch."""
        placed = self._placement
        return Migrants(job=placed.job, variable=placed.variable, term=placed.term, epoch=epoch, blocks=tuple(blocks))

    def sent(self, pull: PullMigrants) -> Migrants | None:
        """Return what islands here have sent to one destination in one epoch; None: nothing that is kept."""
        blocks = [
            Block(source=source, destination=pull.destination, data=data)
            for source in pull.sources
            if (data := self._sent.get((pull.epoch, source), {}).get(pull.destination)) is not None
        ]
        return self.migrants(pull.epoch, blocks) if blocks else None

    def answer_reports(self, pull: PullReports, reported: int) -> Reports | NotYet:
        """Return the reports asked for of epochs below `reported` that are kept, as many as one message bears."""
        reports: list[EpochReport] = []
        additions = 0
        for epoch in range(pull.first, min(pull.last, reported)):
            if epoch in self._reports and additions < ADDITIONS_PER_ANSWER:
                reports.append(self.report(epoch))
                additions += sum(len(island.additions) for island in reports[-1].islands)
        return Reports(reports=tuple(reports)) if reports else NotYet()

    def answer_states(self, pull: PullStates) -> States | NotYet:
        """Return states of a checkpoint, as many as one message bears."""
        states = self._snapshots.get(pull.epoch, {})
        if not states.keys() >= set(pull.islands) or pull.offset >= len(states[pull.islands[0]].data):
            return NotYet()
        return States(pieces=split_states(pull.islands, pull.offset, states.__getitem__))
