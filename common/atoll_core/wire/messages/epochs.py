"""Results of epochs: reports, migrants, states, and the pulls for them.

Envelopes: EpochReport (worker to coordinator); Pull (to a worker; for states also to the coordinator) and PullAnswer.
"""

from typing import Annotated, Literal

from pydantic import Field

from atoll_core.config import Frozen
from atoll_core.wire.messages.limits import (
    CHUNK_SIZE,
    MAX_ISLANDS,
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
from atoll_core.wire.messages.tasks import GivenBatch, PullBatch


class OfTerm(Frozen):
    """Base of the messages about one archipelago under one term; each has its own `kind`."""

    kind: str
    job: Id
    variable: Variable
    term: Term


# ---------------------------------------------------------------------------------------------- reports


class HitStatement(Frozen):
    """The target was reached at `generation` (1-based in the epoch), the end of a slice, with this normalized error."""

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
    """The report of one island for one epoch, finished or given up.

    `generations` is the last generation computed: the epoch's end, the island's own hit, or, after a hit of another
    island, at least the last one that counts. `additions` are the entries added to its front, in the order found.
    `runners_up` are the entries added to its runners-up that were never on the front. `counters` are given for every
    slice that it finished. `best_error` is the smallest finite normalized error on all rows so far (None: there is none
    yet), `digest` the digest of its state.
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
    """Reports of one epoch by the islands of an archipelago on one worker, except islands without slices that count."""

    kind: Literal["report"] = "report"
    epoch: Count
    islands: Annotated[tuple[IslandReport, ...], Field(min_length=1)]


# ---------------------------------------------------------------------------------------------- migrants


class Block(Frozen):
    """Solutions of island `source` for island `destination`, with their slots; only islands read `data`."""

    source: IslandIndex
    destination: IslandIndex
    data: bytes


class PullMigrants(OfTerm):
    """Send the migrants of `epoch` from your islands `sources`, once all of them have finished it."""

    kind: Literal["pull-migrants"] = "pull-migrants"
    epoch: Count
    sources: Annotated[tuple[IslandIndex, ...], Field(min_length=1, max_length=MAX_ISLANDS)]
    destinations: Annotated[tuple[IslandIndex, ...], Field(min_length=1, max_length=MAX_ISLANDS)]


class Migrants(Frozen):
    """Blocks of the requested sources, in order; without the last sources if all do not fit into one message."""

    kind: Literal["migrants"] = "migrants"
    blocks: tuple[Block, ...]


# ---------------------------------------------------------------------------------------------- other pulls


class PullReports(OfTerm):
    """Send your reports of these epochs (first included, last excluded) again."""

    kind: Literal["pull-reports"] = "pull-reports"
    first: Count
    last: Count


class PullStates(OfTerm):
    """Send the states of these islands at checkpoint `epoch`, the first one from byte `offset` on."""

    kind: Literal["pull-states"] = "pull-states"
    epoch: Count
    islands: Annotated[tuple[IslandIndex, ...], Field(min_length=1, max_length=1024)]
    offset: Count = 0


class Pull(Frozen):
    """Request to a worker; for states also to the coordinator."""

    body: Annotated[PullMigrants | PullReports | PullStates | PullBatch, Field(discriminator="kind")]


class Reports(Frozen):
    """The requested reports that exist already."""

    kind: Literal["reports"] = "reports"
    reports: tuple[EpochReport, ...]


class Piece(Frozen):
    """Bytes from `offset` on of the state of one island; the whole state has `size` bytes and the SHA-256 `digest`."""

    island: IslandIndex
    size: Annotated[int, Field(ge=1, le=MAX_STATE)]
    digest: Digest
    offset: Count
    data: Annotated[bytes, Field(max_length=CHUNK_SIZE)]


class States(Frozen):
    """As many of the requested states as fit into one message, in their order; the last one may be incomplete."""

    kind: Literal["states"] = "states"
    pieces: Annotated[tuple[Piece, ...], Field(min_length=1, max_length=1024)]


class NotYet(Frozen):
    """The requested data do not exist here, or not yet. Ask later if the term of the request is still current."""

    kind: Literal["not-yet"] = "not-yet"


class PullAnswer(Frozen):
    """Answer of a worker."""

    body: Annotated[Migrants | Reports | States | NotYet | GivenBatch, Field(discriminator="kind")]
