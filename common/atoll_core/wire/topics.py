"""Keys on the bus: for every kind of key its builder, its parser in `parse`, and the expression that receives it.

All keys on which a worker publishes, serves or announces contain the worker's name. Keys of a client's requests contain
the client's name. So one access rule for each name covers all of its keys. Keys never contain column names: payloads
have them.

    atoll/hello                                served by the coordinator: would a program be accepted? changes nothing
    atoll/hello/{name}                         served by the coordinator: greeting of the worker or client of this name
    atoll/{cluster}/control                    put by the coordinator, to all workers
    atoll/{cluster}/control/{worker}           put by the coordinator, to one worker
    atoll/{cluster}/job/{job}/state            served by the coordinator: states of islands at a checkpoint
    atoll/{cluster}/blob/{digest}/{index}      served by the coordinator: one chunk of a dataset
    atoll/{cluster}/worker/{worker}/alive      presence of a worker
    atoll/{cluster}/worker/{worker}/status     put by the worker: heartbeat
    atoll/{cluster}/worker/{worker}/report     put by the worker: finished epochs
    atoll/{cluster}/worker/{worker}/result     put by the worker: results of tasks
    atoll/{cluster}/worker/{worker}/log        put by the worker: lines of its log
    atoll/{cluster}/worker/{worker}/pull       served by the worker: migrants, reports, states, batches of its task
    atoll/{cluster}/client/{client}/ask        served by the coordinator: requests of a client
    atoll/{cluster}/client/{client}/changes    put by the coordinator: changes that the client follows

The builders raise LocalProtocolError for a name that is no id (`is_id`).
"""

import re
from dataclasses import dataclass
from typing import Final, Literal, cast, get_args

from atoll_core.errors import LocalProtocolError, RemoteProtocolError

ROOT: Final = "atoll"
HELLO: Final = f"{ROOT}/hello"
ALL_GREETINGS: Final = f"{HELLO}/*"

ID: Final = re.compile(r"[A-Za-z0-9_-]{1,64}")
DIGEST: Final = re.compile(r"[0-9a-f]{64}")
MAX_CHUNKS: Final = 1 << 16

WorkerPart = Literal["alive", "status", "report", "result", "pull", "log"]
ClientPart = Literal["ask", "changes"]


@dataclass(frozen=True, slots=True)
class HelloKey:
    """The first request, before the cluster is known.

    It is a greeting from `name`; with None it asks whether a program would be accepted, and changes nothing.
    """

    name: str | None = None


@dataclass(frozen=True, slots=True)
class ControlKey:
    """A message of the coordinator to one worker, or to all (`worker` None)."""

    cluster: str
    worker: str | None = None


@dataclass(frozen=True, slots=True)
class StatesKey:
    """The states of a job's islands at checkpoints."""

    cluster: str
    job: str


@dataclass(frozen=True, slots=True)
class BlobKey:
    """Chunk `index` of the bytes whose SHA-256 is `digest`."""

    cluster: str
    digest: str
    index: int


@dataclass(frozen=True, slots=True)
class WorkerKey:
    """One of the keys under a worker's name."""

    cluster: str
    worker: str
    part: WorkerPart


@dataclass(frozen=True, slots=True)
class ClientKey:
    """A request of a client, or changes of a job that it follows."""

    cluster: str
    client: str
    part: ClientPart = "ask"


Key = HelloKey | ControlKey | StatesKey | BlobKey | WorkerKey | ClientKey


def is_id(text: str) -> bool:
    """Tell whether `text` may name a cluster, job, worker or client: 1 to 64 of A-Z a-z 0-9 _ -."""
    return ID.fullmatch(text) is not None


def hello(name: str) -> str:
    return f"{HELLO}/{_id(name)}"


def control(cluster: str, worker: str | None = None) -> str:
    base = f"{ROOT}/{_id(cluster)}/control"
    return base if worker is None else f"{base}/{_id(worker)}"


def states(cluster: str, job_id: str) -> str:
    return f"{ROOT}/{_id(cluster)}/job/{_id(job_id)}/state"


def blob(cluster: str, digest: str, index: int) -> str:
    if DIGEST.fullmatch(digest) is None or not 0 <= index < MAX_CHUNKS:
        raise LocalProtocolError(f"no blob key can be made of digest {digest!r} and chunk {index}")
    return f"{ROOT}/{_id(cluster)}/blob/{digest}/{index}"


def worker(cluster: str, name: str, part: WorkerPart) -> str:
    return f"{ROOT}/{_id(cluster)}/worker/{_id(name)}/{part}"


def client(cluster: str, name: str, part: ClientPart = "ask") -> str:
    return f"{ROOT}/{_id(cluster)}/client/{_id(name)}/{part}"


def all_states(cluster: str) -> str:
    return f"{ROOT}/{_id(cluster)}/job/*/state"


def all_blobs(cluster: str) -> str:
    return f"{ROOT}/{_id(cluster)}/blob/**"


def all_workers(cluster: str, part: WorkerPart) -> str:
    return f"{ROOT}/{_id(cluster)}/worker/*/{part}"


def all_clients(cluster: str) -> str:
    """Return the expression of the requests of all clients."""
    return f"{ROOT}/{_id(cluster)}/client/*/ask"


def parse(key: str) -> Key:
    """Return the meaning of `key`.

    Raises:
        RemoteProtocolError: it is not one of the keys at the top of this module.
    """
    root, *parts = key.split("/") if len(key) <= 512 else [""]
    parsed: Key | None = None
    match parts if root == ROOT and all(map(is_id, parts)) else []:
        case ["hello", *name] if len(name) <= 1:
            parsed = HelloKey(*name)
        case [cluster, "control", *worker] if len(worker) <= 1:
            parsed = ControlKey(cluster, *worker)
        case [cluster, "job", name, "state"]:
            parsed = StatesKey(cluster, name)
        case [cluster, "blob", digest, index] if DIGEST.fullmatch(digest) and re.fullmatch("0|[1-9][0-9]{0,4}", index):
            parsed = BlobKey(cluster, digest, int(index)) if int(index) < MAX_CHUNKS else None
        case [cluster, "worker", name, part] if part in get_args(WorkerPart):
            parsed = WorkerKey(cluster, name, cast(WorkerPart, part))
        case [cluster, "client", name, "ask" | "changes" as part]:
            parsed = ClientKey(cluster, name, part)
    if parsed is None:
        raise RemoteProtocolError(f"key {key[:200]!r} is none of ours")
    return parsed


def _id(text: str) -> str:
    if not is_id(text):
        raise LocalProtocolError(f"{text!r} cannot stand in a key: 1 to 64 of A-Z a-z 0-9 _ - are allowed")
    return text
