"""A shard: the islands of an archipelago that one worker computes under one term, and their mail. Pure.

An island waits for exactly the senders that the reshuffle of the last epoch names, and gets all immigrants together. So
it computes the same bits regardless of the times and the order in which mail arrives. A term that begins at a
checkpoint begins with the states of its islands, which are pulled from the coordinator.

A hit ends the archipelago at one position in the commit order. A `Finished` message tells the other workers, and every
shard stops computing after that position. Slices before it are still computed and reported, because they may contain an
earlier hit.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

from atoll_core.errors import LocalProtocolError, RemoteProtocolError
from atoll_core.search.commit_order import Position
from atoll_core.wire.messages import epochs
from atoll_core.wire.messages.workers import AssignmentStatus, Commit, Placement
from atoll_core.wire.state_pieces import Assembly
from atoll_island_worker.session import interface as io
from atoll_island_worker.session.kept_messages import Mailbox, RetransmitBuffer

IslandState = Literal["restoring", "ready", "computing", "waiting", "at barrier", "stopped"]
IslandStep = Literal["restore", "begin", "emigrate", "complete", "end", "reject", "reach barrier"]

ISLAND_TRANSITIONS: Final[Mapping[IslandState, Mapping[IslandStep, IslandState]]] = {
    "restoring": {"restore": "ready", "end": "stopped"},
    "ready": {"begin": "computing", "end": "stopped"},
    "computing": {"emigrate": "waiting", "end": "stopped", "reject": "waiting", "reach barrier": "at barrier"},
    "waiting": {"complete": "ready", "end": "stopped"},
    "at barrier": {"end": "stopped"},
    "stopped": {},
}
"""State of one island -> event -> next state. `restoring`: its state is on its way; `computing`: it is in the run
queue; `at barrier`: it waits at a checkpoint for a placement. `end`: a hit here or elsewhere, or the last epoch."""

PULL_AFTER_S: Final = 1.0
"""An island that has waited this long asks the senders; the pause doubles with every question."""

PULL_PAUSE_MAX_S: Final = 8.0

MOST_AHEAD: Final = 1024
"""Mail is filed of epochs at most this far beyond the last one that may begin here."""


@dataclass(slots=True)
class LocalIsland:
    """One island computed here. `epoch` is the one it computes, or will begin; `needs` its sources while it waits."""

    index: int
    state: IslandState = "ready"
    epoch: int = 0
    needs: frozenset[int] = frozenset()
    pause_s: float = PULL_AFTER_S
    pull_at: float | None = None

    def step(self, step: IslandStep) -> None:
        """Go to the next state by the table; raises LocalProtocolError for a pair that is not in it."""
        following = ISLAND_TRANSITIONS[self.state].get(step)
        if following is None:
            raise LocalProtocolError(f"island {self.index} in epoch {self.epoch} cannot {step} while {self.state}")
        self.state = following


class Shard:
    """The islands of one archipelago that this worker computes under one term."""

    def __init__(self, placement: Placement, worker: str) -> None:
        self.placement = placement
        self.worker = worker
        self.key: Final = io.ShardKey(placement.job, placement.variable, placement.term)
        self.schedule = placement.schedule
        first, mine = placement.epoch, placement.islands_of(worker)
        self.islands = {island: LocalIsland(island, "restoring" if first else "ready", first) for island in mine}
        self.hits: dict[int, epochs.IslandFinished] = {}
        self.commit = self.reported = first
        self.waited_s = 0.0
        self.duplicates = 0
        self._names: dict[str, Any] = self.key._asdict()
        self._states = Assembly(mine if first else ())
        self._is_state_asked = False
        self._mailbox = Mailbox()
        self._buffer = RetransmitBuffer(placement, self.islands)
        self._others = tuple(dict.fromkeys(name for name in placement.workers if name != worker))

    @property
    def stop(self) -> Position | None:
        """The earliest known position at which the target was met; nothing after it is needed."""
        hits = (Position(hit.epoch, hit.generation, hit.island) for hit in self.hits.values())
        return min(hits, key=self.placement.commit_order.rank, default=None)

    @property
    def stop_epoch(self) -> int:
        """The last epoch that is needed at least in part, as far as known here."""
        return self.placement.epochs - 1 if self.stop is None else self.stop.epoch

    def assignment_status(self) -> AssignmentStatus:
        """Return the status of this shard for heartbeats."""
        return AssignmentStatus(
            **self._names, islands=len(self.islands), reported=self.reported, commit=self.commit,
            snapshots=self._buffer.snapshots(), waited_s=self.waited_s,
        )  # fmt: skip

    def elapse(self, seconds: float) -> None:
        """Let time pass: it counts for every island here that waits for migrants."""
        self.waited_s += seconds * sum(local.state == "waiting" for local in self.islands.values())

    def is_waiting(self) -> bool:
        """Tell whether any island here is not stopped."""
        return any(local.state != "stopped" for local in self.islands.values())

    def is_computing(self) -> bool:
        """Tell whether any island here is in the run queue."""
        return any(local.state == "computing" for local in self.islands.values())

    # ---------------------------------------------------------------------------------- computations

    def runnable(self) -> Iterator[LocalIsland]:
        """Yield the islands that may begin an epoch now, or take a snapshot: ready, and within the schedule."""
        return (
            local for local in self.islands.values() if local.state == "ready" and local.epoch <= self.schedule.last
        )

    def begin(self, island: int) -> io.EpochTask:
        """Return the task of an island that is ready."""
        local = self.islands[island]
        local.step("begin")
        blocks = state = None
        if local.epoch > self.placement.epoch:
            blocks = self._mailbox.blocks(local.epoch - 1, island, local.needs)
        elif local.epoch > 0:
            state = self._states.states.pop(island).data
        return io.EpochTask(
            io.TaskKey(*self.key, local.index, local.epoch),
            blocks,
            local.epoch + 1 >= self.placement.epochs,
            self.placement.commit_order,
            state,
            takes_snapshot=local.epoch in (self.schedule.next, self.schedule.last),
            is_at_barrier=local.epoch > self.schedule.limit,
        )

    def file_snapshot(self, taken: io.Snapshot) -> bool:
        """File the snapshot of an island; return whether the snapshots of all islands here are complete now."""
        local = self.islands[taken.key.island]
        if taken.is_at_barrier:
            local.step("reach barrier")
            self._mailbox.forget(local.epoch - 1, local.index)
            self._end_late_islands()
        if taken.key.epoch <= self.commit:
            return False
        self._buffer.keep_snapshot(taken.key.epoch, local.index, taken.data)
        return taken.key.epoch in self._buffer.snapshots()

    def computed(self, done: io.EpochComputed) -> list[io.Send]:
        """Store the outcome of an island for the report; return messages with its emigrants, or with a hit."""
        local, key = self.islands[done.key.island], done.key
        self._mailbox.forget(key.epoch - 1, local.index)
        messages: list[io.Send] = []
        if done.report.hit is not None:
            local.step("end")
            generation = done.report.hit.generation
            hit = epochs.IslandFinished(**self._names, epoch=local.epoch, generation=generation, island=local.index)
            self.hits[local.index] = hit
            messages = [io.Send(peer, hit) for peer in self._others]
        elif local.epoch >= self.stop_epoch:
            local.step("end")
        else:
            local.step("emigrate")
            local.epoch += 1
            local.needs = done.senders | (frozenset({local.index}) & frozenset(done.emigrants))
            local.pause_s, local.pull_at = PULL_AFTER_S, None
            self._complete(local)
            messages = self._emigrate(key, done.emigrants)
        self._end_late_islands()
        if key.epoch <= self.stop_epoch:
            self._buffer.keep_report(key.epoch, done.report)
        return messages

    def _emigrate(self, key: io.TaskKey, emigrants: Mapping[int, bytes]) -> list[io.Send]:
        """Keep an island's emigrants, deliver the ones for islands here; return one message for each other worker."""
        self._buffer.keep_emigrants(key.epoch, key.island, emigrants)
        leaving: dict[str, list[epochs.Block]] = {}
        for destination in sorted(emigrants):
            block = epochs.Block(source=key.island, destination=destination, data=emigrants[destination])
            if destination in self.islands:
                self._deliver(key.epoch, block)
            else:
                leaving.setdefault(self.placement.workers[destination], []).append(block)
        return [io.Send(peer, self._buffer.migrants(key.epoch, blocks)) for peer, blocks in leaving.items()]

    def abandoned(self, island: int) -> None:
        """Take in that nothing of an island's epoch is needed."""
        self.islands[island].step("end")

    def rejected(self, island: int) -> bool:
        """Take in that an island refused its immigrants: forget the foreign blocks, so that they are pulled again.

        Returns False if all blocks are our own: pulling again would not help.
        """
        local = self.islands[island]
        if local.epoch == self.placement.epoch or local.needs <= self.islands.keys():
            return False
        self._mailbox.keep_only(local.epoch - 1, island, self.islands)
        local.step("reject")
        local.pull_at = None
        self._end_late_islands()
        return True

    def due_reports(self) -> list[io.SendReport]:
        """Return the reports of epochs that all islands here have finished, in order, each once."""
        due = []
        while reporters := self._buffer.reporters(self.reported):
            if not all(local.index in reporters or local.state == "stopped" for local in self.islands.values()):
                break
            due.append(io.SendReport(self._buffer.report(self.reported)))
            self.reported += 1
        return due

    # ------------------------------------------------------------------------------------ coordinator

    def due_fetch(self) -> epochs.PullStates | None:
        """Return the request for states that are still missing, unless one is under way or none are needed."""
        wanted = self._states.wanted
        if not wanted or self._is_state_asked or self.stop_epoch < self.placement.epoch:
            return None
        self._is_state_asked = True
        return epochs.PullStates(
            **self._names, epoch=self.placement.epoch, islands=wanted, offset=self._states.offset
        )  # fmt: skip

    def fetched(self, body: epochs.States | None) -> bool:
        """Take in the answer to `due_fetch`; return whether it contained anything new.

        Raises:
            RemoteProtocolError: A state was damaged on its way.
        """
        self._is_state_asked = False
        before = (self._states.wanted, self._states.offset)
        for island in self._states.take(body.pieces if body is not None else ()):
            if self.islands[island].state == "restoring":
                self.islands[island].step("restore")
        return (self._states.wanted, self._states.offset) != before

    def commit_at(self, commit: Commit) -> None:
        """Take in how far the archipelago is durable and reported, and forget messages that no process will request
        again.

        Raises:
            RemoteProtocolError: the epoch is later than the last one reported from here.
        """
        if max(commit.epoch, commit.reported) > self.reported:
            raise RemoteProtocolError(
                f"commit {commit.epoch} came, but only {self.reported} epochs were reported from here"
            )
        if commit.epoch >= self.commit:
            self.commit, self.schedule = commit.epoch, commit.schedule
        self._buffer.forget(commit.reported, self.commit)

    def answer_reports(self, pull: epochs.PullReports) -> epochs.Reports | epochs.NotYet:
        """Return the complete reports of the epochs asked for that are still kept, as many as fit one message."""
        return self._buffer.answer_reports(pull, self.reported)

    def answer_states(self, pull: epochs.PullStates) -> epochs.States | epochs.NotYet:
        """Return states of islands of ours at a checkpoint, as many as fit one message."""
        return self._buffer.answer_states(pull)

    # ------------------------------------------------------------------------------------------ peers

    def deliver(self, sender: str, body: epochs.Migrants | epochs.IslandFinished) -> None:
        """File mail of this shard's term.

        Raises:
            RemoteProtocolError: The placement does not give the sender that island, or this worker that destination,
                or the epoch is impossible.
        """
        if body.epoch > self.schedule.last + MOST_AHEAD or body.epoch >= self.placement.epochs:
            raise RemoteProtocolError(f"mail of epoch {body.epoch} came, far beyond commit {self.commit}")
        if isinstance(body, epochs.IslandFinished):
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

    def _check_owner(self, sender: str, island: int) -> None:
        workers = self.placement.workers
        if island >= len(workers) or workers[island] != sender:
            raise RemoteProtocolError(f"worker {sender} sent mail of island {island}, which is placed elsewhere")

    def answer_migrants(self, pull: epochs.PullMigrants) -> epochs.Sent | epochs.NotYet:
        """Return the emigrants of islands of ours to one destination in one epoch."""
        migrants = self._buffer.sent(pull)
        finished = tuple(hit for hit in self.hits.values() if hit.island in self.islands and hit.epoch <= pull.epoch)
        return epochs.Sent(migrants=migrants, finished=finished) if migrants or finished else epochs.NotYet()

    def due_pulls(self, now: float) -> list[tuple[str, epochs.PullMigrants]]:
        """Return (worker, pull) for islands that have waited too long, and set when they ask next."""
        pulls = []
        for local in self.islands.values():
            if local.state != "waiting":
                continue
            if local.pull_at is None:
                local.pull_at = now + local.pause_s
            elif now >= local.pull_at:
                pulls += self._pulls_of(local)
                local.pause_s = min(2 * local.pause_s, PULL_PAUSE_MAX_S)
                local.pull_at = now + local.pause_s
        return pulls

    def _pulls_of(self, local: LocalIsland) -> list[tuple[str, epochs.PullMigrants]]:
        epoch, missing = local.epoch - 1, dict[str, list[int]]()
        for source in sorted(local.needs - self._mailbox.sources(epoch, local.index) - self.islands.keys()):
            missing.setdefault(self.placement.workers[source], []).append(source)
        return [
            (peer, epochs.PullMigrants(**self._names, epoch=epoch, destination=local.index, sources=tuple(sources)))
            for peer, sources in missing.items()
        ]

    def _deliver(self, epoch: int, block: epochs.Block) -> None:
        """File one block, once; a block that is no longer needed is dropped."""
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
        """Stop the islands whose next epoch is not needed."""
        stop = self.stop
        if stop is None:
            return
        for local in self.islands.values():
            is_needed = local.epoch < stop.epoch or (
                local.epoch == stop.epoch and self.placement.commit_order.needed(stop, local.index) > 0
            )
            if local.state in ("restoring", "ready", "waiting", "at barrier") and not is_needed:
                local.step("end")

    # ------------------------------------------------------------------------------------- invariants

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


def _require(condition: bool, sentence: str) -> None:
    if not condition:
        raise LocalProtocolError(f"a shard of an archipelago is inconsistent: {sentence}")
