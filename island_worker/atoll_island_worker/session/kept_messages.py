"""Messages that a worker keeps because other programs may request them. Pure.

Emigrants and reports are kept until every island has reported their epoch; snapshots are kept until they, or a later
checkpoint, are durable at the coordinator.
"""

from collections.abc import Collection, Iterable, Mapping
from typing import Any, Final

from atoll_core.wire.messages import epochs
from atoll_core.wire.messages.limits import CHUNK_SIZE
from atoll_core.wire.messages.workers import Placement
from atoll_core.wire.state_pieces import IslandState, split_states

ADDITIONS_PER_ANSWER: Final = 20_000
"""An answer with reports ends after this many additions to the front; the coordinator requests the rest again."""


class RetransmitBuffer:
    """Emigrants, reports and snapshots of the `islands` of one worker under one term."""

    def __init__(self, placement: Placement, islands: Collection[int]) -> None:
        self._shard: dict[str, Any] = {"job": placement.job, "variable": placement.variable, "term": placement.term}
        self._islands = islands
        self._sent: dict[tuple[int, int], dict[int, bytes]] = {}
        self._reports: dict[int, dict[int, epochs.IslandReport]] = {}
        self._snapshots: dict[int, dict[int, IslandState]] = {}

    def keep_emigrants(self, epoch: int, island: int, emigrants: Mapping[int, bytes]) -> None:
        """Keep the emigrants of an island, by destination."""
        self._sent[epoch, island] = dict(emigrants)

    def keep_report(self, epoch: int, report: epochs.IslandReport) -> None:
        """Keep the report of an island on an epoch."""
        self._reports.setdefault(epoch, {})[report.island] = report

    def keep_snapshot(self, epoch: int, island: int, data: bytes) -> None:
        """Keep the state of an island at a checkpoint."""
        self._snapshots.setdefault(epoch, {})[island] = IslandState.of(data)

    def reporters(self, epoch: int) -> Collection[int]:
        """Return the islands whose reports of an epoch are kept."""
        return self._reports.get(epoch, {}).keys()

    def snapshots(self) -> tuple[int, ...]:
        """Return the epochs for which every island has a snapshot."""
        return tuple(sorted(epoch for epoch, states in self._snapshots.items() if len(states) == len(self._islands)))

    def epochs_sent(self) -> Iterable[int]:
        """Return the epochs whose emigrants are kept."""
        return (epoch for epoch, _ in self._sent)

    def forget(self, reported: int, commit: int) -> None:
        """Forget emigrants and reports of epochs below `reported`, and snapshots up to `commit`."""
        self._sent = {key: blocks for key, blocks in self._sent.items() if key[0] >= reported}
        self._reports = {epoch: reports for epoch, reports in self._reports.items() if epoch >= reported}
        self._snapshots = {epoch: states for epoch, states in self._snapshots.items() if epoch > commit}

    def report(self, epoch: int) -> epochs.EpochReport:
        """Return the report of one epoch, with islands in order."""
        kept = self._reports[epoch]
        islands = tuple(kept[island] for island in sorted(kept))
        return epochs.EpochReport(**self._shard, epoch=epoch, islands=islands)

    def migrants(self, pull: epochs.PullMigrants) -> epochs.Migrants | None:
        """Return the requested emigrants that fit into one message; None: a source has not finished the epoch."""
        if not all((pull.epoch, source) in self._sent for source in pull.sources):
            return None
        blocks: list[epochs.Block] = []
        size = 0
        for source in pull.sources:
            sent = self._sent[pull.epoch, source]
            own = [epochs.Block(source=source, destination=to, data=sent[to]) for to in pull.destinations if to in sent]
            size += sum(len(block.data) for block in own)
            if blocks and size > CHUNK_SIZE:
                break
            blocks += own
        return epochs.Migrants(blocks=tuple(blocks))

    def answer_reports(self, pull: epochs.PullReports, reported: int) -> epochs.Reports | epochs.NotYet:
        """Return the requested reports that are kept, of epochs below `reported`, as many as fit into one message."""
        reports: list[epochs.EpochReport] = []
        additions = 0
        for epoch in range(pull.first, min(pull.last, reported)):
            if epoch in self._reports and additions < ADDITIONS_PER_ANSWER:
                reports.append(self.report(epoch))
                additions += sum(len(island.additions) for island in reports[-1].islands)
        return epochs.Reports(reports=tuple(reports)) if reports else epochs.NotYet()

    def answer_states(self, pull: epochs.PullStates) -> epochs.States | epochs.NotYet:
        """Return states of a checkpoint, as many as fit into one message."""
        states = self._snapshots.get(pull.epoch, {})
        if not states.keys() >= set(pull.islands) or pull.offset >= len(states[pull.islands[0]].data):
            return epochs.NotYet()
        return epochs.States(pieces=split_states(pull.islands, pull.offset, states.__getitem__))
