"""A worker's session: what it computes next, what it sends, keeps, asks and answers. A pure state machine.

Events in (`atoll_island_worker.session.events`), actions out (`atoll_island_worker.session.actions`); no clock, no I/O,
no thread. `Session.handle` is called by the worker's loop, by the simulation and by tests alike. The rules it keeps are
those of docs/protocol.md.
"""

from collections.abc import Mapping
from functools import singledispatchmethod
from typing import Final, Literal

from atoll_core.errors import LocalProtocolError, RemoteProtocolError
from atoll_core.search.commit_order import Position
from atoll_core.wire.messages.epochs import (
    IslandFinished,
    Migrants,
    NewerTerm,
    PullReports,
    PullStates,
    Sent,
)
from atoll_core.wire.messages.views import WorkerState
from atoll_core.wire.messages.workers import (
    AssignmentStatus,
    Close,
    CloseJob,
    Commit,
    IslandFailure,
    Placement,
)
from atoll_island_worker.session.actions import (
    Action,
    AskPeer,
    Discard,
    DiscardJob,
    FetchJob,
    FetchPlacements,
    FetchStates,
    Respond,
    RunTask,
    SendHeartbeat,
    StopAt,
)
from atoll_island_worker.session.epoch_tasks import TaskKey
from atoll_island_worker.session.events import (
    Abandoned,
    Broken,
    Computed,
    JobReady,
    LoadFailed,
    Mailed,
    PullAnswered,
    PullAsked,
    Rejected,
    Reset,
    SessionEvent,
    Snapshot,
    StatesCame,
    Tick,
)
from atoll_island_worker.session.mail import PendingMessages
from atoll_island_worker.session.shard import Shard

JobState = Literal["unknown", "loading", "loaded"]
JobStep = Literal["placed", "ready", "close"]

JOB_TRANSITIONS: Final[Mapping[JobState, Mapping[JobStep, JobState]]] = {
    "unknown": {"placed": "loading", "ready": "loaded", "close": "unknown"},
    "loading": {"placed": "loading", "ready": "loaded", "close": "unknown"},
    "loaded": {"placed": "loaded", "ready": "loaded", "close": "unknown"},
}
"""What this worker has of a job's configuration and dataset -> what happens -> what it has then."""

MAX_TERMS: Final = 1024
"""Of so many archipelagos that are not computed here, the last ones, the newest term is remembered."""

ArchipelagoKey = tuple[str, str]
"""Job and variable."""


class Session:
    """All shards of one worker. Not thread-safe; owned by the worker's loop."""

    def __init__(self, worker: str) -> None:
        self.worker = worker
        self._shards: dict[ArchipelagoKey, Shard] = {}
        self._jobs: dict[str, JobState] = {}
        self._terms: dict[ArchipelagoKey, int] = {}
        self._pending = PendingMessages()
        self._failures: list[IslandFailure] = []
        self._waited_before_s = 0.0
        self._duplicates_before = 0

    @property
    def waited_s(self) -> float:
        """Seconds that islands here have waited for migrants, summed over islands."""
        return self._waited_before_s + sum(shard.waited_s for shard in self._shards.values())

    @property
    def duplicates(self) -> int:
        """Blocks of migrants that came again, or too late, and changed nothing."""
        return self._duplicates_before + sum(shard.duplicates for shard in self._shards.values())

    def elapse(self, seconds: float) -> None:
        """Let time pass, before an event that came after it."""
        for shard in self._shards.values():
            shard.elapse(seconds)

    def handle(self, event: SessionEvent) -> list[Action]:
        """Take in one event and return what is to be done, computations first.

        Raises:
            RemoteProtocolError: A peer's message cannot be; nothing has changed.
            LocalProtocolError: This side broke its own rules.
        """
        actions = self._on(event)
        return self._computations() + actions

    def state(self) -> WorkerState:
        """Return what the heartbeat says of this worker once its kernels are ready."""
        if any(shard.is_computing() for shard in self._shards.values()):
            return "computing"
        return "waiting" if any(shard.is_waiting() for shard in self._shards.values()) else "ready"

    def assignment_statuses(self) -> tuple[AssignmentStatus, ...]:
        """Return what the heartbeat says of every shard."""
        return tuple(shard.assignment_status() for shard in self._shards.values())

    def failures(self) -> tuple[IslandFailure, ...]:
        """Return what broke and has not been closed yet."""
        return tuple(self._failures)

    def jobs(self) -> tuple[str, ...]:
        """Return the jobs of which configuration and dataset are here or on their way."""
        return tuple(job for job, state in self._jobs.items() if state != "unknown")

    def wants(self, job: str) -> bool:
        """Tell whether the job's dataset is still wanted."""
        return any(name == job for name, _ in self._shards)

    def forget_pending(self, job: str) -> None:
        """Forget a job's mail whose placement was asked for and did not come with the answer: it can be pulled."""
        self._pending.forget(job)

    def validate(self) -> None:
        """Check the invariants; raises LocalProtocolError."""
        for (job, variable), shard in self._shards.items():
            shard.validate()
            if self._terms[job, variable] != shard.placement.term:
                raise LocalProtocolError(f"the shard of {job}/{variable} is not of the newest term")

    # ------------------------------------------------------------------------------------ coordinator

    @singledispatchmethod
    def _on(self, event: SessionEvent) -> list[Action]:
        raise LocalProtocolError(f"the session does not know events of kind {type(event).__name__}")

    @_on.register
    def _placed(self, placement: Placement) -> list[Action]:
        key = (placement.job, placement.variable)
        if placement.term <= self._terms.get(key, 0):
            return []
        was_wanted = self.wants(placement.job)
        actions = self._drop(key)
        self._record_term(key, placement.term)
        if self.worker not in placement.workers:
            return actions
        self._shards[key] = Shard(placement, self.worker)
        # Also while it loads: a fetch for islands placed elsewhere meanwhile may have been given up.
        if not was_wanted and self._jobs.get(placement.job) != "loaded":
            actions.append(FetchJob(placement.job))
        self._step_job(placement.job, "placed")
        self._deliver_pending(key)
        return actions + self._fetches(self._shards[key]) + self._stop_from(self._shards[key], None)

    @_on.register
    def _job_ready(self, event: JobReady) -> list[Action]:
        self._step_job(event.job, "ready")
        return []

    @_on.register
    def _load_failed(self, event: LoadFailed) -> list[Action]:
        for (job, variable), shard in self._shards.items():
            if job == event.job:
                island = next(iter(shard.islands))
                key = TaskKey(job, variable, shard.placement.term, island, 0)
                self._add_failure(shard, key, f"the dataset of job {job} cannot be read: {event.sentence}")
        return []

    @_on.register
    def _committed(self, commit: Commit) -> list[Action]:
        shard = self._shards.get((commit.job, commit.variable))
        if shard is not None and shard.placement.term == commit.term:
            shard.commit_at(commit)
        return []

    @_on.register
    def _closed(self, close: Close) -> list[Action]:
        self._pending.forget(close.job, close.variable, close.term)
        shard = self._shards.get((close.job, close.variable))
        return self._drop((close.job, close.variable)) if shard and shard.placement.term <= close.term else []

    @_on.register
    def _job_closed(self, event: CloseJob) -> list[Action]:
        keys = [key for key in self._shards if key[0] == event.job]
        actions: list[Action] = [action for key in keys for action in self._drop(key)]
        self._pending.forget(event.job)
        if self._jobs.get(event.job, "unknown") != "unknown":
            self._step_job(event.job, "close")
            del self._jobs[event.job]
            actions.append(DiscardJob(event.job))
        return actions

    @_on.register
    def _reset(self, event: Reset) -> list[Action]:
        void = [key for key, shard in self._shards.items() if shard.placement.incarnation != event.incarnation]
        actions: list[Action] = [action for key in void for action in self._drop(key)]
        actions += [DiscardJob(job) for job in self.jobs() if not self.wants(job)]
        self._jobs = {job: state for job, state in self._jobs.items() if self.wants(job)}
        self._terms = {key: shard.placement.term for key, shard in self._shards.items()}
        self._pending.clear()
        return actions

    # ------------------------------------------------------------------------------------------ peers

    @_on.register
    def _mailed(self, event: Mailed) -> list[Action]:
        key = (event.body.job, event.body.variable)
        term = self._terms.get(key, 0)
        if event.body.term > term:
            is_first = self._pending.keep(event)
            return [FetchPlacements(event.body.job)] if is_first else []
        shard = self._shards.get(key)
        if shard is None or event.body.term < term:
            return []
        before = shard.stop
        shard.deliver(event.sender, event.body)
        return self._stop_from(shard, before) + list(shard.due_reports())

    @_on.register
    def _pull_asked(self, event: PullAsked) -> list[Action]:
        pull = event.body
        key = (pull.job, pull.variable)
        shard = self._shards.get(key)
        if shard is None or pull.term != shard.placement.term:
            term = self._terms.get(key, 0)
            return [Respond(event.handle, NewerTerm(job=pull.job, variable=pull.variable, term=term))]
        if isinstance(pull, PullReports):
            return [Respond(event.handle, shard.answer_reports(pull))]
        if isinstance(pull, PullStates):
            return [Respond(event.handle, shard.answer_states(pull))]
        return [Respond(event.handle, shard.answer_migrants(pull))]

    @_on.register
    def _pull_answered(self, event: PullAnswered) -> list[Action]:
        body = event.body
        if isinstance(body, NewerTerm) and body.term > self._terms.get((body.job, body.variable), 0):
            return [FetchPlacements(body.job)]
        actions: list[Action] = []
        if isinstance(body, Sent):
            mail: list[Migrants | IslandFinished] = [*([body.migrants] if body.migrants else []), *body.finished]
            for message in mail:
                actions += self._mailed(Mailed(event.peer, message))
        return actions

    @_on.register
    def _tick(self, event: Tick) -> list[Action]:
        actions: list[Action] = []
        for shard in self._shards.values():
            actions += [AskPeer(peer, pull) for peer, pull in shard.due_pulls(event.now)]
            actions += self._fetches(shard)
        return actions

    @_on.register
    def _states_came(self, event: StatesCame) -> list[Action]:
        asked = event.asked
        shard = self._shards.get((asked.job, asked.variable))
        if shard is None or shard.placement.term != asked.term or not shard.fetched(event.body):
            return []  # asked again at the next tick
        return self._fetches(shard)

    # ---------------------------------------------------------------------------------------- compute

    @_on.register
    def _computed(self, event: Computed) -> list[Action]:
        shard = self._shard_computing(event.key)
        return [*shard.computed(event), *shard.due_reports()] if shard else []

    @_on.register
    def _snapshot(self, event: Snapshot) -> list[Action]:
        shard = self._shard_computing(event.key)
        return [SendHeartbeat()] if shard is not None and shard.file_snapshot(event) else []

    @_on.register
    def _rejected(self, event: Rejected) -> list[Action]:
        shard = self._shard_computing(event.key)
        if shard is not None and not shard.rejected(event.key.island):
            self._add_failure(shard, event.key, event.sentence)
        return list(shard.due_reports()) if shard else []

    @_on.register
    def _broken(self, event: Broken) -> list[Action]:
        shard = self._shard_computing(event.key)
        if shard is not None:
            self._add_failure(shard, event.key, event.sentence)
        return []

    @_on.register
    def _abandoned(self, event: Abandoned) -> list[Action]:
        shard = self._shard_computing(event.key)
        if shard is None:
            return []
        shard.abandoned(event.key.island)
        return list(shard.due_reports())

    # ----------------------------------------------------------------------------------------- private

    def _computations(self) -> list[Action]:
        """Begin every island that can begin; in what order they take turns is for the compute thread to say."""
        runnable = [
            (shard, local.index)
            for (job, _), shard in self._shards.items()
            if self._jobs.get(job) == "loaded"
            for local in shard.runnable()
        ]
        return [RunTask(shard.begin(island)) for shard, island in runnable]

    def _fetches(self, shard: Shard) -> list[Action]:
        """Ask for the states with which the term begins, one message at a time."""
        pull = shard.due_fetch()
        return [FetchStates(pull)] if pull is not None else []

    def _stop_from(self, shard: Shard, before: Position | None) -> list[Action]:
        """Have the compute thread stop where the target was met, when that is not where it was before."""
        return (
            []
            if shard.stop is None or shard.stop == before
            else [StopAt(shard.key, shard.stop, shard.placement.commit_order)]
        )

    def _shard_computing(self, key: TaskKey) -> Shard | None:
        """Return the shard of a task that the compute thread is done with, unless the shard is gone.

        Raises LocalProtocolError when it was not computed for that shard.
        """
        shard = self._shard_of(key)
        if shard is not None:
            local = shard.islands.get(key.island)
            if local is None or (local.state, local.epoch) != ("computing", key.epoch):
                raise LocalProtocolError(f"{key} was computed, but nobody asked for it")
        return shard

    def _shard_of(self, key: TaskKey) -> Shard | None:
        shard = self._shards.get((key.job, key.variable))
        return shard if shard is not None and shard.placement.term == key.term else None

    def _add_failure(self, shard: Shard, key: TaskKey, sentence: str) -> None:
        local = shard.islands[key.island]
        if local.state != "stopped":
            local.step("end")
        failure = IslandFailure(
            job=key.job, variable=key.variable, term=key.term, island=key.island, sentence=sentence[:1000]
        )
        self._failures.append(failure)

    def _drop(self, key: ArchipelagoKey) -> list[Action]:
        shard = self._shards.pop(key, None)
        if shard is not None:
            self._waited_before_s += shard.waited_s
            self._duplicates_before += shard.duplicates
        self._failures = [failure for failure in self._failures if (failure.job, failure.variable) != key]
        return [Discard(shard.key)] if shard is not None else []

    def _record_term(self, key: ArchipelagoKey, term: int) -> None:
        """Remember the newest term of an archipelago; of those that are not computed here no more than `MAX_TERMS`.

        Words of a term before one that was forgotten can do no harm: the answer to the next heartbeat sets them right.
        """
        self._terms.pop(key, None)
        self._terms[key] = term
        elsewhere = [
            archipelago for archipelago in self._terms if archipelago not in self._shards and archipelago != key
        ]
        for archipelago in elsewhere[:-MAX_TERMS]:
            del self._terms[archipelago]

    def _step_job(self, job: str, step: JobStep) -> None:
        self._jobs[job] = JOB_TRANSITIONS[self._jobs.get(job, "unknown")][step]

    def _deliver_pending(self, key: ArchipelagoKey) -> None:
        """File the mail that came before its placement; what does not fit is dropped, it can be pulled."""
        shard = self._shards[key]
        for message in self._pending.take(*key):
            if message.body.term == shard.placement.term:
                try:
                    shard.deliver(message.sender, message.body)
                except RemoteProtocolError:
                    continue
