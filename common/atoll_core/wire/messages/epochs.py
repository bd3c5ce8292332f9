"""What comes of epochs: reports, migrants, states, and the questions for them.

Frozen, validated models tagged by `kind`, in envelopes as those of `atoll_core.wire.messages.workers`: EpochReport
(worker to coordinator); Mail (worker to worker); Pull (to a worker; that for states also to the coordinator) and
PullAnswer.
"""

from typing import Annotated, Literal

from pydantic import Field

from atoll_core.config import Frozen
from atoll_core.wire.messages.limits import (
    CHUNK_SIZE,
    MAX_RUNNERS_UP,
    MAX_STATE,
    Count,
    Digest,
    Id,
    IslandIndex,
    Summand,
    Term,
    Variable,
)
from atoll_core.wire.messages.tasks import GivenBatch, NoTask, PullBatch


class OfTerm(Frozen):
    """Base of the messages about one archipelago under one term, each of which has a `kind` of its own."""

    kind: str
    job: Id
    variable: Variable
    term: Term


# ---------------------------------------------------------------------------------------------- reports


class HitStatement(Frozen):
    """The target was met at `generation` (1-based within the epoch), the end of a slice, with this normalized error."""

    generation: Count
    error: float


class Addition(Frozen):
    """One equation found by an island in this epoch; fields as in `atoll_core.search.pareto.FrontEntry`."""

    complexity: Count
    error: float
    mse: float
    generation: Count
    program: Annotated[bytes, Field(max_length=8192)]


class SliceCounters(Frozen):
    """Point evaluations of an island by part, cumulative since epoch 0, at the end of the slice at `generation`."""

    generation: Count
    evaluations: dict[Annotated[str, Field(max_length=64)], Summand]


class IslandReport(Frozen):
    """What one island says of one epoch, finished or given up.

    `generations` is how far it got: to the epoch's end, to its own hit, or, when another island met the target, at
    least as far as is needed then. `additions` are those to its front, in the order found, `runners_up` those that came
    to be the next best beside it without ever having been on it. `counters` are those of all slices that it finished;
    `best_error` is the smallest normalized error on all rows so far (None: none finite yet); `digest` is that of its
    state.
    """

    island: IslandIndex
    generations: Count
    hit: HitStatement | None
    additions: tuple[Addition, ...]
    runners_up: Annotated[tuple[Addition, ...], Field(max_length=MAX_RUNNERS_UP)] = ()
    counters: tuple[SliceCounters, ...]
    best_error: float | None
    digest: Annotated[str, Field(pattern=r"^[0-9a-f]{16,128}$")]


class EpochReport(OfTerm):
    """One worker's islands of one archipelago, one epoch: all but those that the cut spares the whole epoch."""

    kind: Literal["report"] = "report"
    epoch: Count
    islands: Annotated[tuple[IslandReport, ...], Field(min_length=1)]


# ---------------------------------------------------------------------------------------------- migrants


class Block(Frozen):
    """Solutions of island `source` for island `destination`, with their slots; opaque to all but the island."""

    source: IslandIndex
    destination: IslandIndex
    data: bytes


class Migrants(OfTerm):
    """Emigrants of one finished epoch for islands of one worker."""

    kind: Literal["migrants"] = "migrants"
    epoch: Count
    blocks: Annotated[tuple[Block, ...], Field(min_length=1)]


class Finished(OfTerm):
    """In place of emigrants: `island` met the target at `generation` of `epoch`; nothing after that is needed."""

    kind: Literal["finished"] = "finished"
    epoch: Count
    generation: Count
    island: IslandIndex


class Mail(Frozen):
    """From worker to worker."""

    body: Annotated[Migrants | Finished, Field(discriminator="kind")]


# ---------------------------------------------------------------------------------------------- pulls


class PullMigrants(OfTerm):
    """What did the `sources` of yours send in `epoch` to island `destination`?"""

    kind: Literal["pull-migrants"] = "pull-migrants"
    epoch: Count
    destination: IslandIndex
    sources: Annotated[tuple[IslandIndex, ...], Field(min_length=1)]


class PullReports(OfTerm):
    """What did you report of these epochs (first included, last excluded)?"""

    kind: Literal["pull-reports"] = "pull-reports"
    first: Count
    last: Count


class PullStates(OfTerm):
    """What are the states of these islands at checkpoint `epoch`, of the first one from byte `offset` on?"""

    kind: Literal["pull-states"] = "pull-states"
    epoch: Count
    islands: Annotated[tuple[IslandIndex, ...], Field(min_length=1, max_length=1024)]
    offset: Count = 0


class Pull(Frozen):
    """Question to a worker; that for states also to the coordinator."""

    body: Annotated[PullMigrants | PullReports | PullStates | PullBatch, Field(discriminator="kind")]


class Sent(Frozen):
    """The migrants asked for, as far as they exist already, and those sources that finished instead."""

    kind: Literal["sent"] = "sent"
    migrants: Migrants | None
    finished: tuple[Finished, ...] = ()


class Reports(Frozen):
    """The reports asked for, as far as they exist already."""

    kind: Literal["reports"] = "reports"
    reports: tuple[EpochReport, ...]


class Piece(Frozen):
    """Bytes from `offset` on of the state of one island; the whole has `size` bytes and the SHA-256 `digest`."""

    island: IslandIndex
    size: Annotated[int, Field(ge=1, le=MAX_STATE)]
    digest: Digest
    offset: Count
    data: Annotated[bytes, Field(max_length=CHUNK_SIZE)]


class States(Frozen):
    """As many of the states asked for as one message bears, in their order; the last one may be a part of it."""

    kind: Literal["states"] = "states"
    pieces: Annotated[tuple[Piece, ...], Field(min_length=1, max_length=1024)]


class NotYet(Frozen):
    """Nothing of what was asked for exists yet; ask later."""

    kind: Literal["not-yet"] = "not-yet"


class NewerTerm(OfTerm):
    """The question's term is over; `term` is the one that the answerer knows (0: it holds nothing there)."""

    kind: Literal["newer-term"] = "newer-term"
    term: Count


class PullAnswer(Frozen):
    """Answer of a worker."""

    body: Annotated[Sent | Reports | States | NotYet | NewerTerm | GivenBatch | NoTask, Field(discriminator="kind")]
