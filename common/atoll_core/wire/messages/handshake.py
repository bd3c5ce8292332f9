"""The messages with which a worker or a client registers, and the answers. Other versions can read them."""

from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from atoll_core.config import Frozen
from atoll_core.wire.messages.limits import Count, Id, Sentence


class Tolerant(Frozen):
    """A message whose shape other versions must be able to read: fields they do not know are ignored."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class Hello(Tolerant):
    """The first message of a worker or a client. `instance` is a random id of the process.

    `fingerprint` identifies the kernels, on which the bits of a worker's islands depend ("" while they are not ready,
    and for a client). `cores` and `memory_bytes` are available to all processes of its host together.
    """

    kind: Literal["hello"] = "hello"
    role: Literal["worker", "client"]
    name: Id
    instance: Id
    protocol: Count
    version: Annotated[str, Field(max_length=64)]
    engine: Count
    fingerprint: Annotated[str, Field(max_length=128)] = ""
    host: Annotated[str, Field(max_length=256)] = ""
    pid: Count = 0
    cores: Count = 1
    memory_bytes: Count = 0


class Welcome(Tolerant):
    """The coordinator accepts; all further keys lie under its cluster, `realm`.

    `clock` is its time of day as ISO text, "" if unknown.
    """

    kind: Literal["welcome"] = "welcome"
    realm: Id
    incarnation: Count
    protocol: Count
    version: Annotated[str, Field(max_length=64)]
    engine: Count
    clock: Annotated[str, Field(max_length=64)] = ""


class Refusal(Tolerant):
    """The coordinator refuses; `sentence` says why and names both sides' versions where they differ."""

    kind: Literal["refusal"] = "refusal"
    protocol: Count
    version: Annotated[str, Field(max_length=64)]
    engine: Count
    sentence: Sentence


class Greeting(Tolerant):
    """Request on the hello key."""

    body: Hello


class GreetingAnswer(Tolerant):
    """Answer on the hello key."""

    body: Annotated[Welcome | Refusal, Field(discriminator="kind")]
