"""Keys on the bus: for every kind of key its builder, its parser in `parse`, and the expression that receives it.

Everything a worker publishes, serves or announces lies under its own name, a client's requests under the client's own,
so that one access rule per name fences them all. Column names never enter a key: they travel in payloads.

    atoll/hello                              served by the coordinator: would we be welcome? changes nothing
    atoll/hello/{name}                       served by the coordinator: a worker or client of this name comes
    atoll/{realm}/control                    put by the coordinator, to all workers
    atoll/{realm}/control/{worker}           put by the coordinator, to one worker
    atoll/{realm}/job/{job}                  served by the coordinator: announcement
    atoll/{realm}/job/{job}/placement        served by the coordinator: current placements
    atoll/{realm}/job/{job}/state            served by the coordinator: states of islands at a checkpoint
    atoll/{realm}/blob/{digest}/{index}      served by the coordinator: one chunk of a dataset
    atoll/{realm}/worker/{worker}/alive      presence of a worker
    atoll/{realm}/worker/{worker}/status     put by the worker: heartbeat
    atoll/{realm}/worker/{worker}/report     put by the worker: finished epochs
    atoll/{realm}/worker/{worker}/pull       served by the worker: what it sent and still keeps
    atoll/{realm}/worker/{worker}/to/{peer}  put by the worker: migrants for islands of `peer`
    atoll/{realm}/client/{client}/ask        served by the coordinator: requests of the command line
"""

import re
from dataclasses import dataclass
from typing import Final, Literal, cast, get_args

from atoll_core.errors import LocalProtocolError, RemoteProtocolError

ROOT: Final = "atoll"
HELLO: Final = f"{ROOT}/hello"

ID: Final = re.compile(r"[A-Za-z0-9_-]{1,64}")
DIGEST: Final = re.compile(r"[0-9a-f]{64}")
MAX_CHUNKS: Final = 1 << 16

WorkerPart = Literal["alive", "status", "report", "pull"]


@dataclass(frozen=True, slots=True)
class HelloKey:
    """The first question, before the realm is known: from `name`, or (None) whether there would be a place for it."""

    name: str | None = None


@dataclass(frozen=True, slots=True)
class ControlKey:
    """Word of the coordinator to one worker, or to all (`worker` None)."""

    realm: str
    worker: str | None = None


@dataclass(frozen=True, slots=True)
class JobKey:
    """A job's announcement."""

    realm: str
    job: str


@dataclass(frozen=True, slots=True)
class PlacementKey:
    """A job's current placements."""

    realm: str
    job: str


@dataclass(frozen=True, slots=True)
class StateKey:
    """States of a job's islands at its checkpoints."""

    realm: str
    job: str


@dataclass(frozen=True, slots=True)
class BlobKey:
    """Chunk `index` of the bytes whose SHA-256 is `digest`."""

    realm: str
    digest: str
    index: int


@dataclass(frozen=True, slots=True)
class WorkerKey:
    """One of the keys under a worker's name."""

    realm: str
    worker: str
    part: WorkerPart


@dataclass(frozen=True, slots=True)
class MailKey:
    """Migrants from `worker` to `peer`."""

    realm: str
    worker: str
    peer: str


@dataclass(frozen=True, slots=True)
class ClientKey:
    """A request of a client."""

    realm: str
    client: str


Key = HelloKey | ControlKey | JobKey | PlacementKey | StateKey | BlobKey | WorkerKey | MailKey | ClientKey


def is_id(text: str) -> bool:
    """Tell whether `text` may name a realm, job, worker or client: 1 to 64 of A-Z a-z 0-9 _ -."""
    return ID.fullmatch(text) is not None


def hello(name: str) -> str:
    """Return the key on which the bearer of `name` greets the coordinator."""
    return f"{HELLO}/{_id(name)}"


def control(realm: str, worker: str | None = None) -> str:
    """Return the key on which the coordinator tells one worker something, or all of them."""
    base = f"{ROOT}/{_id(realm)}/control"
    return base if worker is None else f"{base}/{_id(worker)}"


def job(realm: str, job_id: str) -> str:
    """Return the key of a job's announcement."""
    return f"{ROOT}/{_id(realm)}/job/{_id(job_id)}"


def placement(realm: str, job_id: str) -> str:
    """Return the key of a job's current placements."""
    return f"{job(realm, job_id)}/placement"


def state(realm: str, job_id: str) -> str:
    """Return the key of the states of a job's islands."""
    return f"{job(realm, job_id)}/state"


def blob(realm: str, digest: str, index: int) -> str:
    """Return the key of chunk `index` (0-based) of the bytes with SHA-256 `digest`."""
    if DIGEST.fullmatch(digest) is None or not 0 <= index < MAX_CHUNKS:
        raise LocalProtocolError(f"no blob key can be made of digest {digest!r} and chunk {index}")
    return f"{ROOT}/{_id(realm)}/blob/{digest}/{index}"


def worker(realm: str, name: str, part: WorkerPart) -> str:
    """Return a key under a worker's name."""
    return f"{ROOT}/{_id(realm)}/worker/{_id(name)}/{part}"


def mail(realm: str, name: str, peer: str) -> str:
    """Return the key on which worker `name` sends migrants to worker `peer`."""
    return f"{ROOT}/{_id(realm)}/worker/{_id(name)}/to/{_id(peer)}"


def client(realm: str, name: str) -> str:
    """Return the key on which a client asks the coordinator."""
    return f"{ROOT}/{_id(realm)}/client/{_id(name)}/ask"


def all_greetings() -> str:
    """Return the expression of the greetings of all names."""
    return f"{HELLO}/*"


def all_jobs(realm: str) -> str:
    """Return the expression of all announcements, placements and states."""
    return f"{ROOT}/{_id(realm)}/job/**"


def all_blobs(realm: str) -> str:
    """Return the expression of all chunks."""
    return f"{ROOT}/{_id(realm)}/blob/**"


def all_workers(realm: str, part: WorkerPart) -> str:
    """Return the expression of one part of all workers."""
    return f"{ROOT}/{_id(realm)}/worker/*/{part}"


def all_clients(realm: str) -> str:
    """Return the expression of all clients' requests."""
    return f"{ROOT}/{_id(realm)}/client/*/ask"


def inbox(realm: str, name: str) -> str:
    """Return the expression of all mail to worker `name`."""
    return f"{ROOT}/{_id(realm)}/worker/*/to/{_id(name)}"


def parse(key: str) -> Key:
    """Return what `key` means.

    Raises:
        RemoteProtocolError: It is none of the keys at the top of this module.
    """
    parsed = _parse(key.split("/")) if len(key) <= 512 else None
    if parsed is None:
        raise RemoteProtocolError(f"key {key[:200]!r} is none of ours")
    return parsed


def _parse(parts: list[str]) -> Key | None:
    if parts[:2] == [ROOT, "hello"]:
        return _parse_hello(parts[2:])
    if len(parts) < 3 or parts[0] != ROOT or not all(is_id(part) for part in parts[1:]):
        return None
    return _parse_in_realm(parts[1], parts[2:])


def _parse_hello(rest: list[str]) -> HelloKey | None:
    if not rest:
        return HelloKey()
    return HelloKey(rest[0]) if len(rest) == 1 and is_id(rest[0]) else None


def _parse_in_realm(realm: str, rest: list[str]) -> Key | None:
    parsed: Key | None = None
    match rest:
        case ["control"]:
            parsed = ControlKey(realm)
        case ["control", name]:
            parsed = ControlKey(realm, name)
        case ["job", name]:
            parsed = JobKey(realm, name)
        case ["job", name, "placement"]:
            parsed = PlacementKey(realm, name)
        case ["job", name, "state"]:
            parsed = StateKey(realm, name)
        case ["blob", digest, index] if DIGEST.fullmatch(digest) and re.fullmatch("0|[1-9][0-9]{0,4}", index):
            parsed = BlobKey(realm, digest, int(index)) if int(index) < MAX_CHUNKS else None
        case ["worker", name, part] if part in get_args(WorkerPart):
            parsed = WorkerKey(realm, name, cast(WorkerPart, part))
        case ["worker", name, "to", peer]:
            parsed = MailKey(realm, name, peer)
        case ["client", name, "ask"]:
            parsed = ClientKey(realm, name)
    return parsed


def _id(text: str) -> str:
    if not is_id(text):
        raise LocalProtocolError(f"{text!r} cannot stand in a key: 1 to 64 of A-Z a-z 0-9 _ - are allowed")
    return text
