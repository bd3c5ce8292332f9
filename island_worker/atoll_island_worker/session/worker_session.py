"""A worker's session: decides what the worker computes, sends, keeps, requests and answers. A pure state machine.

Events go in, actions come out (both in `atoll_island_worker.session.interface`); there is no clock, I/O or thread.
`Session.handle` is called by the worker's loop, by the simulation and by tests. It follows the rules of
docs/protocol.md.

Each archipelago that is placed here has a `Shard` of the newest term that this worker knows. Pulls under other terms
get empty answers and are repeated; the answers to heartbeats contain missing placements. So the result does not depend
on the order in which messages arrive. A lost message only costs time, because migrants, reports and states can all be
requested again.
"""

from typing import Final

from atoll_core.errors import LocalProtocolError
from atoll_core.wire.messages import epochs, workers
from atoll_core.wire.messages.views import WorkerState
from atoll_island_worker.session import interface as io
from atoll_island_worker.session.shard import Shard

MAX_TERMS: Final = 1024
"""Number of archipelagos not computed here whose newest terms are remembered."""

ArchipelagoKey = tuple[str, str]
"""Job and variable."""


class Session:
    """All shards of one worker. Not thread-safe; only the worker's loop may call it."""

    def __init__(self, worker: str) -> None:
        self.worker = worker
        self._shards: dict[ArchipelagoKey, Shard] = {}
        self._loaded: dict[str, None] = {}
        self._terms: dict[ArchipelagoKey, int] = {}
        self._failures: list[workers.IslandFailure] = []
        self._waited_before_s = 0.0
        self._duplicates_before = 0

    @property
    def waited_s(self) -> float:
        """Seconds that islands here have waited for migrants, summed over islands."""
        return self._waited_before_s + sum(shard.waited_s for shard in self._shards.values())

    @property
    def duplicates(self) -> int:
        """Number of blocks of migrants that came again, or too late, and had no effect."""
        return self._duplicates_before + sum(shard.duplicates for shard in self._shards.values())

    def elapse(self, seconds: float) -> None:
        """Let time pass until the next event."""
        for shard in self._shards.values():
            shard.elapse(seconds)

    def state(self) -> WorkerState:
        """Return the state that heartbeats report once the kernels are ready."""
        if any(shard.is_computing() for shard in self._shards.values()):
            return "computing"
        return "waiting" if any(shard.is_waiting() for shard in self._shards.values()) else "ready"

    def assignment_statuses(self) -> tuple[workers.AssignmentStatus, ...]:
        """Return the status of every shard for heartbeats."""
        return tuple(shard.assignment_status() for shard in self._shards.values())

    def failures(self) -> tuple[workers.IslandFailure, ...]:
        """Return the failures of archipelagos that have not been closed yet."""
        return tuple(self._failures)

    def has_reported(self, key: io.ShardKey, epoch: int) -> bool:
        """Tell whether the report of an epoch was sent, or the archipelago is not computed here any more."""
        shard = self._shards.get((key.job, key.variable))
        return shard is None or shard.key != key or shard.reported > epoch

    def jobs(self) -> tuple[str, ...]:
        """Return the jobs with loaded configuration and dataset."""
        return tuple(self._loaded)

    def wants(self, job: str) -> bool:
        """Tell whether the job's dataset is still needed."""
        return any(name == job for name, _ in self._shards)

    def validate(self) -> None:
        """Check the invariants; raises LocalProtocolError."""
        for (job, variable), shard in self._shards.items():
            shard.validate()
            if self._terms[job, variable] != shard.placement.term:
                raise LocalProtocolError(f"the shard of {job}/{variable} is not of the newest term")

    def handle(self, event: io.SessionEvent) -> list[io.Action]:
        """Handle one event and return the actions, computations first.

        Raises:
            RemoteProtocolError: A peer's message is invalid; the state is unchanged.
            LocalProtocolError: This worker broke the rules of the protocol.
        """
        actions = self._handle_event(event)
        # All islands that can begin an epoch do so; the compute thread decides about turns.
        runnable = [
            (shard, local.index)
            for (job, _), shard in self._shards.items()
            if job in self._loaded
            for local in shard.runnable()
        ]
        begun = [io.RunTask(shard.begin(island)) for shard, island in runnable]
        early = [pull for shard, island in runnable for pull in shard.early_pulls(shard.islands[island].epoch)]
        return [*begun, *actions, *early]

    def _handle_event(self, event: io.SessionEvent) -> list[io.Action]:  # noqa: C901  # a table of events
        match event:
            case workers.Placement():
                return self._placed(event)
            case io.JobReady():
                self._loaded[event.job] = None
            case io.LoadFailed():
                self._load_failed(event)
            case workers.Commit():
                shard = self._shards.get((event.job, event.variable))
                if shard is not None and shard.placement.term == event.term:
                    hit = shard.commit_at(event)
                    stops = [io.StopAt(shard.key, hit, shard.placement.commit_order)] if hit is not None else []
                    return [*stops, *shard.due_reports()]
            case workers.Close():
                shard = self._shards.get((event.job, event.variable))
                return self._drop((event.job, event.variable)) if shard and shard.placement.term <= event.term else []
            case workers.CloseJob():
                return self._job_closed(event.job)
            case io.Reset():
                return self._reset(event.incarnation)
            case io.PullAsked(handle=handle, body=pull):
                shard = self._shards.get((pull.job, pull.variable))
                if shard is None or pull.term != shard.placement.term:
                    return [io.Respond(handle, epochs.NotYet())]
                return [*shard.pull_asked(handle, pull)]
            case io.PullEnded(asked=io.SendPull(body=pull)):
                shard = self._shards.get((pull.job, pull.variable))
                if shard is not None and shard.placement.term == pull.term:
                    return [*shard.pull_ended(event)]
            case io.Tick():
                return [pull for shard in self._shards.values() for pull in shard.due_pulls()]
            case io.EpochComputed() | io.Snapshot() | io.Rejected() | io.Broken() | io.Abandoned():
                return self._task_done(event)
            case _:
                raise LocalProtocolError(f"the session does not know events of kind {type(event).__name__}")
        return []

    # ------------------------------------------------------------------------------------ coordinator

    def _placed(self, placement: workers.Placement) -> list[io.Action]:
        key = (placement.job, placement.variable)
        if placement.term <= self._terms.get(key, 0):
            return []
        actions = self._drop(key)
        self._record_term(key, placement.term)
        if self.worker not in placement.workers:
            return actions
        shard = self._shards[key] = Shard(placement, self.worker)
        return [*actions, *shard.due_pulls()]

    def _load_failed(self, event: io.LoadFailed) -> None:
        for (job, variable), shard in self._shards.items():
            if job == event.job:
                key = io.TaskKey(job, variable, shard.placement.term, next(iter(shard.islands)), 0)
                self._add_failure(shard, key, f"the dataset of job {job} cannot be read: {event.sentence}")

    def _job_closed(self, job: str) -> list[io.Action]:
        keys = [key for key in self._shards if key[0] == job]
        actions: list[io.Action] = [action for key in keys for action in self._drop(key)]
        self._loaded.pop(job, None)
        return actions

    def _reset(self, incarnation: int) -> list[io.Action]:
        void = [key for key, shard in self._shards.items() if shard.placement.incarnation != incarnation]
        actions: list[io.Action] = [action for key in void for action in self._drop(key)]
        self._loaded = {job: None for job in self._loaded if self.wants(job)}
        self._terms = {key: shard.placement.term for key, shard in self._shards.items()}
        return actions

    # ------------------------------------------------------------------------------------------ peers

    def _task_done(self, event: io.Snapshot | io.Outcome) -> list[io.Action]:
        key = event.key
        shard = self._shards.get((key.job, key.variable))
        if shard is None or shard.placement.term != key.term:
            return []
        local = shard.islands.get(key.island)
        if local is None or (local.state, local.epoch) != ("computing", key.epoch):
            raise LocalProtocolError(f"{key} was computed, but was not requested")
        actions: list[io.Action] = []
        match event:
            case io.Snapshot():
                return [io.SendHeartbeat()] if shard.file_snapshot(event) else []
            case io.Broken():
                self._add_failure(shard, key, event.sentence)
                return []
            case io.EpochComputed():
                actions += shard.computed(event)
            case io.Rejected():
                if not shard.rejected(key.island):
                    self._add_failure(shard, key, event.sentence)
            case io.Abandoned():
                shard.abandoned(key.island)
        return [*actions, *shard.due_reports()]

    # ---------------------------------------------------------------------------------------- private

    def _add_failure(self, shard: Shard, key: io.TaskKey, sentence: str) -> None:
        local = shard.islands[key.island]
        if local.state != "stopped":
            local.step("end")
        self._failures.append(
            workers.IslandFailure(
                job=key.job, variable=key.variable, term=key.term, island=key.island, sentence=sentence[:1000]
            )
        )

    def _drop(self, key: ArchipelagoKey) -> list[io.Action]:
        shard = self._shards.pop(key, None)
        if shard is not None:
            self._waited_before_s += shard.waited_s
            self._duplicates_before += shard.duplicates
        self._failures = [failure for failure in self._failures if (failure.job, failure.variable) != key]
        return [io.Discard(shard.key)] if shard is not None else []

    def _record_term(self, key: ArchipelagoKey, term: int) -> None:
        """Remember the newest term of an archipelago.

        Archipelagos that are not computed here have at most `MAX_TERMS` terms.

        A forgotten term does no harm: the answer to the next heartbeat corrects a worker that follows an older term.
        """
        self._terms.pop(key, None)
        self._terms[key] = term
        elsewhere = [other for other in self._terms if other not in self._shards and other != key]
        for archipelago in elsewhere[:-MAX_TERMS]:
            del self._terms[archipelago]
