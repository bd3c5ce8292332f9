"""A shard: the islands of an archipelago that one worker computes under one term, their mail, and their buffers. Pure.

An island waits for exactly the senders that the reshuffle names, and the immigrants are handed over together. A term
that begins at a checkpoint begins with the states of its islands, which are pulled from the coordinator.
"""

from collections.abc import Iterator, Mapping
from typing import Final

from atoll_core.errors import LocalProtocolError, RemoteProtocolError
from atoll_core.search.commit_order import Position
from atoll_core.wire.messages.epochs import (
    Block,
    IslandFinished,
    Migrants,
    NotYet,
    PullMigrants,
    PullReports,
    PullStates,
    Reports,
    Sent,
    States,
)
from atoll_core.wire.messages.workers import AssignmentStatus, Commit, Placement
from atoll_island_worker.session.actions import Send, SendReport
from atoll_island_worker.session.epoch_tasks import ShardKey, Task, TaskKey
from atoll_island_worker.session.events import Computed, Snapshot
from atoll_island_worker.session.local_island import PULL_AFTER_S, LocalIsland
from atoll_island_worker.session.mail import Mailbox
from atoll_island_worker.session.retransmit_buffer import RetransmitBuffer
from atoll_island_worker.session.state_transfer import StateTransfer

MOST_AHEAD: Final = 1024
"""Mail is filed of epochs at most so far beyond the last one that may begin here."""


class Shard:
    """The islands of one archipelago that this worker computes under one term."""

    def __init__(self, placement: Placement, worker: str) -> None:
        self.placement = placement
        self.worker = worker
        self.schedule = placement.schedule
        first, mine = placement.epoch, placement.islands_of(worker)
        self.islands = {island: LocalIsland(island, "restoring" if first else "ready", first) for island in mine}
        self.hits: dict[int, IslandFinished] = {}
        self.commit = self.reported = first
        self.waited_s = 0.0
        self.duplicates = 0
        self._transfer = StateTransfer(placement, mine if first else ())
        self._mailbox = Mailbox()
        self._buffer = RetransmitBuffer(placement, self.islands)
        self._others = tuple(dict.fromkeys(name for name in placement.workers if name != worker))

    @property
    def key(self) -> ShardKey:
        """Archipelago and term."""
        return ShardKey(self.placement.job, self.placement.variable, self.placement.term)

    @property
    def stop(self) -> Position | None:
        """Where the target was met, as far as known here; nothing after it is needed."""
        hits = (Position(hit.epoch, hit.generation, hit.island) for hit in self.hits.values())
        return min(hits, key=self.placement.commit_order.rank, default=None)

    @property
    def stop_epoch(self) -> int:
        """The last epoch of which anything is needed, as far as known here."""
        return self.placement.epochs - 1 if self.stop is None else self.stop.epoch

    def assignment_status(self) -> AssignmentStatus:
        """Return what the heartbeat says of this shard."""
        placed = self.placement
        return AssignmentStatus(
            job=placed.job,
            variable=placed.variable,
            term=placed.term,
            islands=len(self.islands),
            reported=self.reported,
            commit=self.commit,
            snapshots=self._buffer.snapshots(),
            waited_s=self.waited_s,
        )

    def elapse(self, seconds: float) -> None:
        """Let time pass: it counts for every island here that waits for migrants."""
        waiting = sum(local.state == "waiting" for local in self.islands.values())
        self.waited_s += seconds * waiting

    def runnable(self) -> Iterator[LocalIsland]:
        """Yield the islands that may begin an epoch now, or take a snapshot: ready, and within the schedule."""
        return (
            local for local in self.islands.values() if local.state == "ready" and local.epoch <= self.schedule.last
        )

    def begin(self, island: int) -> Task:
        """Return the task of an island that is ready."""
        local = self.islands[island]
        local.step("begin")
        blocks = state = None
        if local.epoch > self.placement.epoch:
            blocks = self._mailbox.blocks(local.epoch - 1, island, local.needs)
        elif local.epoch > 0:
            state = self._transfer.hand_over(island)
        return Task(
            self._key(local),
            blocks,
            local.epoch + 1 >= self.placement.epochs,
            self.placement.commit_order,
            state,
            takes_snapshot=local.epoch in (self.schedule.next, self.schedule.last),
            is_at_barrier=local.epoch > self.schedule.limit,
        )

    def file_snapshot(self, taken: Snapshot) -> bool:
        """File the snapshot of an island; return whether those of all islands here are there now."""
        local = self.islands[taken.key.island]
        if taken.is_at_barrier:
            local.step("reach barrier")
            self._mailbox.forget(local.epoch - 1, local.index)
            self._end_late_islands()
        if taken.key.epoch <= self.commit:
            return False
        self._buffer.keep_snapshot(taken.key.epoch, local.index, taken.data)
        return taken.key.epoch in self._buffer.snapshots()

    def due_fetch(self) -> PullStates | None:
        """Return the question for the states that are still missing, if there are any and none is under way."""
        return self._transfer.due_fetch() if self.stop_epoch >= self.placement.epoch else None

    def fetched(self, body: States | None) -> bool:
        """Take in the answer to `due_fetch`; return whether it brought anything.

        Raises:
            RemoteProtocolError: A state was damaged on its way.
        """
        got_on, whole = self._transfer.take(body)
        for island in whole:
            if self.islands[island].state == "restoring":
                self.islands[island].step("restore")
        return got_on

    def computed(self, done: Computed) -> list[Send | SendReport]:
        """File what an island computed: report it, and send emigrants or the statement of a hit."""
        local = self.islands[done.key.island]
        self._mailbox.forget(done.key.epoch - 1, local.index)
        actions = self._depart(local, done)
        self._end_late_islands()
        if done.key.epoch <= self.stop_epoch:
            self._buffer.keep_report(done.key.epoch, done.report)
        return actions

    def abandoned(self, island: int) -> None:
        """File that nothing of an island's epoch is needed."""
        self.islands[island].step("end")

    def due_reports(self) -> list[SendReport]:
        """Return the reports of the epochs of which no island here has any more to say, in order, each once."""
        due = []
        while self._buffer.reporters(self.reported) and self._is_settled(self.reported):
            due.append(SendReport(self._buffer.report(self.reported)))
            self.reported += 1
        return due

    def rejected(self, island: int) -> bool:
        """File that an island refused its immigrants: forget the foreign blocks, so that they are pulled again.

        Returns False when all of them are our own, which no pull can mend.
        """
        local = self.islands[island]
        if local.epoch == self.placement.epoch or local.needs <= self.islands.keys():
            return False
        self._mailbox.keep_only(local.epoch - 1, island, self.islands)
        local.step("reject")
        local.pull_at = None
        self._end_late_islands()
        return True

    def deliver(self, sender: str, body: Migrants | IslandFinished) -> None:
        """File mail of this shard's term.

        Raises:
            RemoteProtocolError: The placement does not give the sender that island, or ours that destination, or the
                epoch cannot be.
        """
        if body.epoch > self.schedule.last + MOST_AHEAD or body.epoch >= self.placement.epochs:
            raise RemoteProtocolError(f"mail of epoch {body.epoch} came, far beyond commit {self.commit}")
        if isinstance(body, IslandFinished):
            self._check_owner(sender, body.island)
            self.hits.setdefault(body.island, body)
            self._end_late_islands()
            return
        for block in body.blocks:
            self._check_owner(sender, block.source)
            if block.destination not in self.islands:
                raise RemoteProtocolError(f"mail came for island {block.destination}, which is not computed here")
        for block in body.blocks:
            self._deliver(body.epoch, block)

    def commit_at(self, commit: Commit) -> None:
        """Take in how far the archipelago is durable and reported, and forget what nobody can ask for any more.

        Raises:
            RemoteProtocolError: The epoch is beyond what has been reported from here.
        """
        if max(commit.epoch, commit.reported) > self.reported:
            raise RemoteProtocolError(
                f"commit {commit.epoch} came, but only {self.reported} epochs were reported from here"
            )
        if commit.epoch >= self.commit:
            self.commit, self.schedule = commit.epoch, commit.schedule
        self._buffer.forget(commit.reported, self.commit)

    def answer_migrants(self, pull: PullMigrants) -> Sent | NotYet:
        """Return what islands of ours have sent to one destination in one epoch."""
        migrants = self._buffer.sent(pull)
        finished = tuple(hit for hit in self.hits.values() if hit.island in self.islands and hit.epoch <= pull.epoch)
        return Sent(migrants=migrants, finished=finished) if migrants or finished else NotYet()

    def answer_reports(self, pull: PullReports) -> Reports | NotYet:
        """Return the complete reports of the epochs asked for that are still kept, as many as one message bears."""
        return self._buffer.answer_reports(pull, self.reported)

    def answer_states(self, pull: PullStates) -> States | NotYet:
        """Return states of islands of ours at a checkpoint, as many as one message bears."""
        return self._buffer.answer_states(pull)

    def due_pulls(self, now: float) -> list[tuple[str, PullMigrants]]:
        """Return (worker, pull) for islands that have waited too long, and set when they ask next."""
        pulls = []
        for local in self.islands.values():
            if local.state == "waiting":
                pulls += self._pulls_of(local) if local.is_pull_due(now) else []
                local.schedule_pull(now)
        return pulls

    def is_waiting(self) -> bool:
        """Tell whether any island here still has something to do or to wait for."""
        return any(local.state != "stopped" for local in self.islands.values())

    def is_computing(self) -> bool:
        """Tell whether any island here is in the run queue."""
        return any(local.state == "computing" for local in self.islands.values())

    def validate(self) -> None:
        """Check the invariants; raises LocalProtocolError."""
        for local in self.islands.values():
            have = self._mailbox.sources(local.epoch - 1, local.index)
            complete = local.epoch == self.placement.epoch or local.needs <= have
            _require(local.state != "ready" or complete, f"island {local.index} is ready without its immigrants")
            _require(local.state != "waiting" or not complete, f"island {local.index} waits for nothing")
            _require(local.epoch < self.placement.epochs, f"island {local.index} is beyond the last epoch")
        _require(all(epoch >= self.placement.epoch for epoch in self._buffer.epochs_sent()), "emigrants are too old")
        _require(all(epoch > self.commit for epoch in self._buffer.snapshots()), "snapshots of a commit are kept")
        is_young = (epoch >= self.islands[island].epoch - 1 for epoch, island in self._mailbox.filed())
        _require(all(is_young), "old immigrants are kept")

    def _key(self, local: LocalIsland) -> TaskKey:
        return TaskKey(self.placement.job, self.placement.variable, self.placement.term, local.index, local.epoch)

    def _depart(self, local: LocalIsland, done: Computed) -> list[Send | SendReport]:
        """Take an island out of `computing`."""
        if done.report.hit is not None:
            return self._state_hit(local, done.report.hit.generation)
        if local.epoch >= self.stop_epoch:
            local.step("end")
            return []
        local.step("emigrate")
        local.epoch += 1
        local.needs = done.senders | (frozenset({local.index}) & frozenset(done.emigrants))
        local.pause_s, local.pull_at = PULL_AFTER_S, None
        self._complete(local)
        return self._emigrate(done.key, done.emigrants)

    def _state_hit(self, local: LocalIsland, generation: int) -> list[Send | SendReport]:
        local.step("end")
        placed = self.placement
        hit = IslandFinished(
            job=placed.job,
            variable=placed.variable,
            term=placed.term,
            epoch=local.epoch,
            generation=generation,
            island=local.index,
        )
        self.hits[local.index] = hit
        return [Send(peer, hit) for peer in self._others]

    def _emigrate(self, key: TaskKey, emigrants: Mapping[int, bytes]) -> list[Send | SendReport]:
        """Keep, deliver and send an island's emigrants: one message for each other worker."""
        self._buffer.keep_emigrants(key.epoch, key.island, emigrants)
        leaving: dict[str, list[Block]] = {}
        for destination in sorted(emigrants):
            block = Block(source=key.island, destination=destination, data=emigrants[destination])
            if destination in self.islands:
                self._deliver(key.epoch, block)
            else:
                leaving.setdefault(self.placement.workers[destination], []).append(block)
        return [Send(peer, self._buffer.migrants(key.epoch, blocks)) for peer, blocks in leaving.items()]

    def _deliver(self, epoch: int, block: Block) -> None:
        """File one block, once; one that is no longer needed is dropped."""
        local = self.islands[block.destination]
        was_handed_over = local.state in ("restoring", "computing", "at barrier") or local.epoch == self.placement.epoch
        is_late = epoch < local.epoch - 1 or (epoch == local.epoch - 1 and was_handed_over)
        if is_late or local.state == "stopped":
            self.duplicates += 1
            return
        self.duplicates += not self._mailbox.file(epoch, block)
        self._complete(local)

    def _complete(self, local: LocalIsland) -> None:
        if local.state == "waiting" and local.needs <= self._mailbox.sources(local.epoch - 1, local.index):
            local.step("complete")

    def _end_late_islands(self) -> None:
        """Stop the islands of whose next epoch nothing is needed."""
        for local in self.islands.values():
            if local.state in ("restoring", "ready", "waiting", "at barrier") and not self._is_needed(local):
                local.step("end")

    def _is_needed(self, local: LocalIsland) -> bool:
        stop = self.stop
        if stop is None or local.epoch < stop.epoch:
            return True
        return local.epoch == stop.epoch and self.placement.commit_order.needed(stop, local.index) > 0

    def _is_settled(self, epoch: int) -> bool:
        there = self._buffer.reporters(epoch)
        return all(local.index in there or local.state == "stopped" for local in self.islands.values())

    def _check_owner(self, sender: str, island: int) -> None:
        workers = self.placement.workers
        if island >= len(workers) or workers[island] != sender:
            raise RemoteProtocolError(f"worker {sender} spoke for island {island}, which is placed elsewhere")

    def _pulls_of(self, local: LocalIsland) -> list[tuple[str, PullMigrants]]:
        have = self._mailbox.sources(local.epoch - 1, local.index)
        missing: dict[str, list[int]] = {}
        for source in sorted(local.needs - have - self.islands.keys()):
            missing.setdefault(self.placement.workers[source], []).append(source)
        return [(peer, self._pull(local, sources)) for peer, sources in missing.items()]

    def _pull(self, local: LocalIsland, sources: list[int]) -> PullMigrants:
        placed = self.placement
        return PullMigrants(
            job=placed.job,
            variable=placed.variable,
            term=placed.term,
            epoch=local.epoch - 1,
            destination=local.index,
            sources=tuple(sources),
        )


def _require(condition: bool, sentence: str) -> None:
    if not condition:
        raise LocalProtocolError(f"a shard of an archipelago is inconsistent: {sentence}")
