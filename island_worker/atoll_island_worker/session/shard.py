"""A shard: the islands of an archipelago that one worker computes under one term, and their migrants. Pure.

An island waits for exactly the senders that the reshuffle of the last epoch names, and gets all immigrants together. So
the times and the order of arrivals do not change the computed bits. Migrants are pulled: when the first island here
begins an epoch, this worker requests the emigrants of that epoch from every other worker. Each worker answers when its
islands have finished the epoch. A pull that timed out is repeated as soon as an island here waits for its migrants; a
pull that was refused is repeated at a tick. If a term begins at a checkpoint, the states of its islands are pulled from
the coordinator in the same way.

A hit (an island meets the target) ends the archipelago at one position in the commit order. A report tells the
coordinator the hit, or a heartbeat if islands here are still computing; the coordinator's commits tell it the other
workers. Every shard stops computing after that
position. Slices before the position are still computed and reported, because they may contain an earlier hit. These
slices do not need emigrants of the epoch of the hit, so the result does not depend on the time when a worker learns of
the hit.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal

from atoll_core.errors import LocalProtocolError, RemoteProtocolError
from atoll_core.search.commit_order import Position
from atoll_core.wire.bus.interface import Query
from atoll_core.wire.messages import epochs
from atoll_core.wire.messages.workers import AssignmentStatus, Commit, Placement
from atoll_core.wire.state_pieces import Assembly
from atoll_island_worker.session import interface as io
from atoll_island_worker.session.kept_messages import RetransmitBuffer

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
"""State of one island -> event -> next state. State `restoring`: the island's data are being pulled; `computing`: it is
in the run queue; `at barrier`: it waits at a checkpoint for a placement. Event `end`: a hit here or elsewhere, or the
last epoch."""

MAX_HELD: Final = 4096
"""Most pulls of migrants that wait here for their answers; further pulls are answered at once without migrants, and
their workers repeat them."""


@dataclass(slots=True)
class LocalIsland:
    """One island computed here.

    `epoch` is the epoch that it computes or will begin; `needs` are its sources while it waits.

    `immigrants` are the arrived blocks by epoch and source that the island has not received yet. Each block is stored
    once, so the order of the answers has no influence.
    """

    index: int
    state: IslandState = "ready"
    epoch: int = 0
    needs: frozenset[int] = frozenset()
    immigrants: dict[int, dict[int, bytes]] = field(default_factory=dict)

    @property
    def arrived(self) -> dict[int, bytes]:
        """The arrived immigrants of the epoch before `epoch`, by source."""
        return self.immigrants.get(self.epoch - 1, {})

    def step(self, step: IslandStep) -> None:
        """Go to the next state by the table; raises LocalProtocolError if the table has no such transition."""
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
        self.stop: Position | None = None
        """The earliest known position at which the target was met; slices after it are not needed."""
        self.commit = self.reported = first
        self.waited_s = 0.0
        self.duplicates = 0
        self._names: dict[str, Any] = self.key._asdict()
        self._states = Assembly(mine if first else ())
        self._under_way: set[tuple[str | None, int]] = set()
        self._pulled = first - 1
        self._held: dict[epochs.PullMigrants, Query] = {}
        self._buffer = RetransmitBuffer(placement, self.islands)

    @property
    def stop_epoch(self) -> int:
        """The last epoch that is needed at least in part, according to the hits known here."""
        return self.placement.epochs - 1 if self.stop is None else self.stop.epoch

    def assignment_status(self) -> AssignmentStatus:
        """Return the status of this shard for heartbeats."""
        return AssignmentStatus(
            **self._names, islands=len(self.islands), reported=self.reported, commit=self.commit,
            snapshots=self._buffer.snapshots(), waited_s=self.waited_s, hit=self.stop,
        )  # fmt: skip

    def elapse(self, seconds: float) -> None:
        """Let time pass: it counts as waiting time for every island here that waits for migrants."""
        self.waited_s += seconds * sum(local.state == "waiting" for local in self.islands.values())

    def is_waiting(self) -> bool:
        """Tell whether any island here has not stopped yet."""
        return any(local.state != "stopped" for local in self.islands.values())

    def is_computing(self) -> bool:
        """Tell whether any island here is in the run queue."""
        return any(local.state == "computing" for local in self.islands.values())

    # ---------------------------------------------------------------------------------- computations

    def runnable(self) -> Iterator[LocalIsland]:
        """Yield the islands that may begin an epoch or take a snapshot now: they are ready, and within the schedule."""
        return (
            local for local in self.islands.values() if local.state == "ready" and local.epoch <= self.schedule.last
        )

    def begin(self, island: int) -> io.EpochTask:
        """Return the task of an island that is ready."""
        local = self.islands[island]
        local.step("begin")
        blocks = state = None
        if local.epoch > self.placement.epoch:
            blocks = {source: local.arrived[source] for source in sorted(local.needs)}
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
        """Store the snapshot of an island; return whether all islands here now have their snapshots."""
        local = self.islands[taken.key.island]
        if taken.is_at_barrier:
            local.step("reach barrier")
            local.immigrants.pop(local.epoch - 1, None)
            self._end_late_islands()
        if taken.key.epoch <= self.commit:
            return False
        self._buffer.keep_snapshot(taken.key.epoch, local.index, taken.data)
        return taken.key.epoch in self._buffer.snapshots()

    def computed(self, done: io.EpochComputed) -> list[io.Action]:
        """Store the outcome of an island for the report.

        Return answers with its emigrants, and pulls of its immigrants.
        """
        local, key = self.islands[done.key.island], done.key
        local.immigrants.pop(key.epoch - 1, None)
        actions: list[io.Action] = []
        if done.report.hit is not None:
            local.step("end")
            self.stop_at(Position(local.epoch, done.report.hit.generation, local.index))
            actions = [io.AnnounceHit(self.key, local.epoch)]
        elif local.epoch >= self.stop_epoch:
            local.step("end")
        else:
            local.step("emigrate")
            local.epoch += 1
            local.needs = done.senders | (frozenset({local.index}) & frozenset(done.emigrants))
            self._complete(local)
            self._buffer.keep_emigrants(key.epoch, key.island, done.emigrants)
            for destination in done.emigrants.keys() & self.islands.keys():
                data = done.emigrants[destination]
                self._deliver(key.epoch, epochs.Block(source=key.island, destination=destination, data=data))
            actions = [*self._answers(), *self._missing_of(local)]
        self._end_late_islands()
        if key.epoch <= self.stop_epoch:
            self._buffer.keep_report(key.epoch, done.report)
        return actions

    def _answers(self) -> list[io.Respond]:
        """Return the answers to waiting pulls of migrants whose sources have finished the epoch now."""
        answers = {pull: body for pull in self._held if (body := self._buffer.migrants(pull)) is not None}
        return [io.Respond(self._held.pop(pull), body) for pull, body in answers.items()]

    def abandoned(self, island: int) -> None:
        """Record that no part of an island's epoch is needed."""
        self.islands[island].step("end")

    def rejected(self, island: int) -> bool:
        """Record that an island rejected its immigrants.

        Blocks of other workers are forgotten, so that they are pulled again. Returns False if all blocks are from this
        worker: pulling again would not help.
        """
        local = self.islands[island]
        if local.epoch == self.placement.epoch or local.needs <= self.islands.keys():
            return False
        local.immigrants[local.epoch - 1] = {
            source: data for source, data in local.arrived.items() if source in self.islands
        }
        local.step("reject")
        self._end_late_islands()
        return True

    def due_reports(self) -> list[io.SendReport]:
        """Return, in order, the reports of epochs that all islands here have finished; each report is returned once."""
        due = []
        while reporters := self._buffer.reporters(self.reported):
            if not all(local.index in reporters or local.state == "stopped" for local in self.islands.values()):
                break
            due.append(io.SendReport(self._buffer.report(self.reported)))
            self.reported += 1
        return due

    # ------------------------------------------------------------------------------------ coordinator

    def commit_at(self, commit: Commit) -> Position | None:
        """Record how far the archipelago is durable and reported.

        Forget messages that no process will request again; return the position of a hit, if it is earlier than known
        before.

        Raises:
            RemoteProtocolError: the epoch is later than the last epoch reported from here.
        """
        if max(commit.epoch, commit.reported) > self.reported:
            raise RemoteProtocolError(
                f"commit {commit.epoch} came, but only {self.reported} epochs were reported from here"
            )
        if commit.epoch >= self.commit:
            self.commit, self.schedule = commit.epoch, commit.schedule
        self._buffer.forget(commit.reported, self.commit)
        return self.stop_at(commit.hit)

    # ------------------------------------------------------------------------------------------ pulls

    def pull_asked(
        self, handle: Query, pull: epochs.PullMigrants | epochs.PullReports | epochs.PullStates
    ) -> list[io.Respond]:
        """Answer a pull; let a pull of migrants wait while a source has not finished the epoch."""
        match pull:
            case epochs.PullReports():
                return [io.Respond(handle, self._buffer.answer_reports(pull, self.reported))]
            case epochs.PullStates():
                return [io.Respond(handle, self._buffer.answer_states(pull))]
        if not self.islands.keys() >= set(pull.sources) or len(self._held) >= MAX_HELD:
            return [io.Respond(handle, epochs.NotYet())]
        self._held[pull] = handle  # replaces the same pull, which has timed out
        return self._answers()

    def early_pulls(self, epoch: int) -> list[io.SendPull]:
        """Return pulls of all emigrants of an epoch that begins here; each is returned once."""
        if epoch <= self._pulled or epoch + 1 >= self.placement.epochs or epoch > self.schedule.limit:
            return []
        self._pulled = epoch
        return self._pulls(epoch, range(len(self.placement.workers)), self.islands)

    def due_pulls(self) -> list[io.SendPull]:
        """Return pulls of missing states and migrants, except pulls that are under way."""
        pulls: list[io.SendPull] = []
        first, wanted = self.placement.epoch, self._states.wanted
        if wanted and (None, first) not in self._under_way and self.stop_epoch >= first:
            self._under_way.add((None, first))
            states = epochs.PullStates(**self._names, epoch=first, islands=wanted, offset=self._states.offset)
            pulls.append(io.SendPull(None, states))
        return pulls + self._missing()

    def _missing_of(self, local: LocalIsland) -> list[io.SendPull]:
        """Return missing pulls if an island that begins to wait needs one that is not under way.

        The other islands do not matter: their pulls were sent when they began to wait, when a pull ended, or at a tick.
        """
        peers = {self.placement.workers[source] for source in local.needs - local.arrived.keys()} - {self.worker}
        if all((peer, local.epoch - 1) in self._under_way for peer in peers):
            return []
        return self._missing()

    def _missing(self) -> list[io.SendPull]:
        """Return pulls of the migrants that islands here wait for, except pulls that are under way.

        A pull is for all islands here that still need migrants of its epoch: pulls for one island after another would
        each wait for the end of the previous pull.
        """
        missing: dict[int, set[int]] = {}
        for local in self.islands.values():
            if local.state == "waiting":
                missing.setdefault(local.epoch - 1, set()).update(local.needs - local.arrived.keys())
        return [
            pull
            for epoch in sorted(missing)
            for pull in self._pulls(epoch, sorted(missing[epoch]), self._receivers(epoch))
        ]

    def _receivers(self, epoch: int) -> list[int]:
        """Return the islands here that wait for migrants of an epoch, or have not finished this epoch."""
        return [
            local.index
            for local in self.islands.values()
            if (local.state == "waiting" and local.epoch == epoch + 1)
            or (local.state != "stopped" and local.epoch <= epoch)
        ]

    def _pulls(self, epoch: int, sources: Iterable[int], destinations: Iterable[int]) -> list[io.SendPull]:
        """Return one pull for each other worker with some of these sources, except pulls that are under way."""
        by_worker: dict[str, list[int]] = {}
        for source in sources:
            by_worker.setdefault(self.placement.workers[source], []).append(source)
        peers = [peer for peer in by_worker if peer != self.worker and (peer, epoch) not in self._under_way]
        self._under_way.update((peer, epoch) for peer in peers)
        return [
            io.SendPull(
                peer,
                epochs.PullMigrants(
                    **self._names, epoch=epoch, sources=tuple(by_worker[peer]), destinations=tuple(destinations)
                ),
            )
            for peer in peers
        ]

    def pull_ended(self, ended: io.PullEnded) -> list[io.SendPull]:
        """Process the answer to a pull; return pulls for migrants and states that are still missing.

        Raises:
            RemoteProtocolError: The answer contains blocks that were not requested, or a state was damaged in transit.
        """
        pull = ended.asked.body
        self._under_way.discard((ended.asked.peer, pull.epoch))
        match pull, ended.body:
            case epochs.PullStates(), epochs.States(pieces=pieces):
                for island in self._states.take(pieces):
                    if self.islands[island].state == "restoring":
                        self.islands[island].step("restore")
            case epochs.PullMigrants(), epochs.Migrants(blocks=blocks) if blocks:
                for block in blocks:
                    if block.source not in pull.sources or block.destination not in pull.destinations:
                        raise RemoteProtocolError(
                            f"migrants of island {block.source} to {block.destination} came, which were not requested"
                        )
                for block in blocks:
                    self._deliver(pull.epoch, block)
            case _ if (
                not ended.has_timed_out
            ):  # the other worker has refused, or is not there: the next tick repeats it
                return []
        return self.due_pulls()

    def _deliver(self, epoch: int, block: epochs.Block) -> None:
        """Store one block, once; a block that is no longer needed is dropped."""
        local = self.islands[block.destination]
        was_handed_over = local.state in ("restoring", "computing", "at barrier") or local.epoch == self.placement.epoch
        is_late = epoch < local.epoch - 1 or (epoch == local.epoch - 1 and was_handed_over)
        if is_late or local.state == "stopped":
            self.duplicates += 1
            return
        filed = local.immigrants.setdefault(epoch, {})
        self.duplicates += block.source in filed
        filed.setdefault(block.source, block.data)
        self._complete(local)

    def _complete(self, local: LocalIsland) -> None:
        if local.state == "waiting" and local.needs <= local.arrived.keys():
            local.step("complete")

    def stop_at(self, hit: Position | None) -> Position | None:
        """Record the position of a hit; return it if it is earlier than known before."""
        order = self.placement.commit_order
        if hit is None or (self.stop is not None and order.rank(self.stop) <= order.rank(hit)):
            return None
        self.stop = hit
        self._end_late_islands()
        return hit

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
            complete = local.epoch == self.placement.epoch or local.needs <= local.arrived.keys()
            _require(local.state != "ready" or complete, f"island {local.index} is ready without its immigrants")
            _require(local.state != "waiting" or not complete, f"island {local.index} waits for nothing")
            _require(local.epoch < self.placement.epochs, f"island {local.index} is beyond the last epoch")
            _require(all(epoch >= local.epoch - 1 for epoch in local.immigrants), "old immigrants are kept")
        _require(all(epoch >= self.placement.epoch for epoch in self._buffer.epochs_sent()), "emigrants are too old")
        _require(all(epoch > self.commit for epoch in self._buffer.snapshots()), "snapshots of a commit are kept")


def _require(condition: bool, sentence: str) -> None:
    if not condition:
        raise LocalProtocolError(f"a shard of an archipelago is inconsistent: {sentence}")
