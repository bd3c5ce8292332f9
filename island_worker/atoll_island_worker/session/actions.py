"""What a worker's session wants done. Plain data, no behaviour."""

from dataclasses import dataclass

from atoll_core.search.commit_order import CommitOrder, Position
from atoll_core.wire.bus.interface import Query
from atoll_core.wire.messages.epochs import (
    EpochReport,
    IslandFinished,
    Migrants,
    NewerTerm,
    NotYet,
    PullMigrants,
    PullStates,
    Reports,
    Sent,
    States,
)
from atoll_island_worker.session.epoch_tasks import ShardKey, Task


@dataclass(frozen=True, slots=True)
class FetchJob:
    """Load the job's configuration and dataset; JobReady follows."""

    job: str


@dataclass(frozen=True, slots=True)
class FetchPlacements:
    """Ask the coordinator for the job's current placements; Placement follows."""

    job: str


@dataclass(frozen=True, slots=True)
class FetchStates:
    """Ask the coordinator for states of a checkpoint; StatesCame follows."""

    body: PullStates


@dataclass(frozen=True, slots=True)
class SendHeartbeat:
    """Tell the coordinator at once what is held."""


@dataclass(frozen=True, slots=True)
class RunTask:
    """Give the task to the compute thread; a Snapshot, Computed, Rejected, Broken or Abandoned follows."""

    task: Task


@dataclass(frozen=True, slots=True)
class StopAt:
    """Compute nothing of the shard that is not needed when the target was met at `hit`."""

    shard: ShardKey
    hit: Position
    commit_order: CommitOrder


@dataclass(frozen=True, slots=True)
class Discard:
    """Forget the islands of one archipelago under one term, also those that are being computed."""

    shard: ShardKey


@dataclass(frozen=True, slots=True)
class DiscardJob:
    """Forget the job's dataset."""

    job: str


@dataclass(frozen=True, slots=True)
class Send:
    """Send mail to worker `peer`."""

    peer: str
    body: Migrants | IslandFinished


@dataclass(frozen=True, slots=True)
class SendReport:
    """Report to the coordinator."""

    report: EpochReport


@dataclass(frozen=True, slots=True)
class AskPeer:
    """Pull from worker `peer`; PullAnswered may follow."""

    peer: str
    body: PullMigrants


@dataclass(frozen=True, slots=True)
class Respond:
    """Answer the pull that came under `handle`."""

    handle: Query
    body: Sent | Reports | States | NotYet | NewerTerm


Outgoing = Send | SendReport | AskPeer | Respond | FetchPlacements | FetchStates
"""What goes out on the bus."""

Action = RunTask | StopAt | Discard | DiscardJob | FetchJob | SendHeartbeat | Outgoing
