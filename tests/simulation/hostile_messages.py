"""Hostile messages: mutated valid ones of every kind, against the decoder and against a service at work.

Valid messages are overheard in a simulated run. Most mutated ones go to the decoder: each must come out as a message or
as a RemoteProtocolError. The others are put, or asked, by a stranger while a job runs: those that are not understood on
the very keys of coordinator and workers, the rest under the stranger's own name, which is all that access rules let
pass. The job must come to the result of the calm run, and memory must stay where it was.

    python -m tests.simulation.hostile_messages --messages 1000000 --seed 0
"""

import argparse
import copy
import logging
import resource
import sys
import time
from argparse import Namespace
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import msgpack

from atoll.terminal.output import say
from atoll_core.config import BudgetConfig, EvolutionConfig, JobConfig
from atoll_core.errors import RemoteProtocolError
from atoll_core.search.seeding import Stream, stream_key
from atoll_core.wire import topics
from atoll_core.wire.codec import decode
from atoll_core.wire.messages.clients import Answer, ClientRequest
from atoll_core.wire.messages.epochs import EpochReport, Pull, PullAnswer
from atoll_core.wire.messages.handshake import Greeting, GreetingAnswer
from atoll_core.wire.messages.limits import MAX_MESSAGE
from atoll_core.wire.messages.workers import Control, WorkerStatus
from benchmarks.harness.command_line import option, program
from benchmarks.harness.tables import grouped
from tests.simulation.bus.fault_plan import Plan
from tests.simulation.harness.simulated_cluster import World, bus_of, comparable

CONFIG = JobConfig(seed=3, evolution=EvolutionConfig(islands=4), budget=BudgetConfig(max_epochs=14))
SESSION_SHARE = 5
PER_WORLD = 20_000
HOSTILE: tuple[Any, ...] = (
    *(None, True, -1, 2**63, 2**64 - 1, -(2**63), float("nan"), float("inf"), -0.0, 1e308, "", "x" * 300),
    *("../../etc/passwd", "a/b", "*", "**", "a$*", "\x00", "job\n", "é" * 64, b"", b"\xff" * 300, [], {}, [[]] * 50),
    *({"kind": "report"}, {"": None}, [None] * 500, {str(number): number for number in range(300)}),
)
"""What replaces a part of a message."""

RAW: tuple[bytes, ...] = (
    *(b"\xdd\xff\xff\xff\xff", b"\xdf\xff\xff\xff\xff", b"\xdb\xff\xff\xff\xff", b"\xc6\xff\xff\xff\xff", b"\xc1"),
    *(b"\xd4\x00\x00", b"\xd6\xff\x00\x00\x00\x00", b"\xc9\x00\x00\x00\x05\x01abcde", b"\x91" * 100, b"\x81\xa0" * 60),
    *(b"\xcb\x7f\xf8\x00\x00\x00\x00\x00\x00", b"\x81\x90\x01", b"\x82\xa1a\x01\xa1a\x02", b"\x80" * 200, b"\x00"),
)
"""What is written into the bytes of a message: lies about lengths, extensions, nesting, keys that are none, doubles."""


@dataclass(frozen=True)
class Overheard:
    """One valid message: where it went, which envelope it is, and its bytes."""

    key: str
    kind: Any
    payload: bytes
    is_question: bool


@dataclass
class Score:
    """What became of the mutated messages, by envelope."""

    refused: Counter[str] = field(default_factory=Counter)
    understood: Counter[str] = field(default_factory=Counter)
    sent: int = 0
    rejects: int = 0
    worlds: int = 0


def overhear(seed: int = 0) -> list[Overheard]:
    """Return the different messages of a run with losses, so that there are pulls as well."""
    world = World(workers=2, seed=seed, plan=Plan(drop=0.05))
    heard: dict[tuple[str, bytes], Overheard] = {}

    def note(key: str, payload: bytes | None, kind: Any, is_question: bool) -> None:
        if payload is not None and kind is not None:
            heard.setdefault((kind.__name__, payload), Overheard(key, kind, payload, is_question))

    network: Any = world.network
    publish, ask, answer = network.publish, network.ask, network.answer

    def spy_publish(sender: Any, key: str, payload: bytes) -> None:
        note(key, payload, put_kind(key), False)
        publish(sender, key, payload)

    def spy_ask(asker: Any, question: Any, key: str, payload: bytes) -> None:
        question.spied_key = key
        note(key, payload, asked_kind(key), True)
        ask(asker, question, key, payload)

    def spy_answer(server: Any, question: Any, payload: bytes | None) -> None:
        key = getattr(question, "spied_key", None)  # a greeting may be under way before anybody listens
        if key is not None:
            note(key, payload, answered_kind(key), False)
        answer(server, question, payload)

    network.publish, network.ask, network.answer = spy_publish, spy_ask, spy_answer
    world.run(CONFIG)
    world.close()
    return list(heard.values())


def put_kind(key: str) -> Any:
    """Return the envelope of what is put on a key."""
    match topics.parse(key):
        case topics.ControlKey():
            return Control
        case topics.WorkerKey(part="status"):
            return WorkerStatus
        case topics.WorkerKey(part="report"):
            return EpochReport
    return None


def asked_kind(key: str) -> Any:
    """Return the envelope of a question on a key."""
    match topics.parse(key):
        case topics.HelloKey():
            return Greeting
        case topics.ClientKey():
            return ClientRequest
        case topics.WorkerKey(part="pull"):
            return Pull
    return None


def answered_kind(key: str) -> Any:
    """Return the envelope of an answer on a key."""
    match topics.parse(key):
        case topics.HelloKey():
            return GreetingAnswer
        case topics.ClientKey():
            return Answer
        case topics.WorkerKey(part="pull"):
            return PullAnswer
    return None


class Mutator:
    """Spoils messages, by one stream."""

    def __init__(self, seed: int) -> None:
        self._stream = Stream(stream_key(seed, "", -1, 0, "fuzz"))

    def below(self, limit: int) -> int:
        """Return a number from 0 to `limit` - 1."""
        return self._stream.below(limit)

    def mutate(self, payload: bytes) -> bytes:
        """Return the message with one part replaced, or with its bytes spoilt."""
        return self._replaced(payload) if self.below(2) else self._spoilt(payload)

    def _hostile(self) -> Any:
        return copy.deepcopy(HOSTILE[self.below(len(HOSTILE))])

    def _spoilt(self, payload: bytes) -> bytes:
        data = bytearray(payload)
        for _ in range(1 + self.below(3)):
            place = self.below(len(data) + 1)
            match self.below(5):
                case 0:
                    data[place : place + 1] = bytes([self.below(256)])
                case 1:
                    data[place : place + self.below(9)] = b""
                case 2:
                    data[place:place] = RAW[self.below(len(RAW))]
                case 3:
                    del data[place:]
                case _:
                    data[place : place + 1] = RAW[self.below(len(RAW))]
        return bytes(data)

    def _replaced(self, payload: bytes) -> bytes:
        tree = msgpack.unpackb(payload)
        for _ in range(1 + self.below(2)):
            holder: Any = [tree]
            at: Any = 0
            while isinstance(holder[at], dict | list) and holder[at] and self.below(4):
                holder = holder[at]
                at = self.below(len(holder)) if isinstance(holder, list) else list(holder)[self.below(len(holder))]
            if isinstance(holder, dict) and not self.below(5):
                holder[f"extra{self.below(3)}"] = self._hostile()
            elif holder is not tree and len(holder) == 1 and isinstance(holder, list) and holder[0] is tree:
                tree = self._hostile()
            else:
                holder[at] = self._hostile()
        return bytes(msgpack.packb(tree))


def is_understood(message: Overheard, payload: bytes, score: Score) -> bool:
    """Decode; count what became of it. Whatever is raised but RemoteProtocolError ends the benchmark."""
    try:
        decode(payload, message.kind, MAX_MESSAGE)
    except RemoteProtocolError:
        score.refused[message.kind.__name__] += 1
        return False
    score.understood[message.kind.__name__] += 1
    return True


def fuzz_decoder(messages: list[Overheard], number: int, mutator: Mutator, score: Score) -> None:
    """Decode so many mutated messages."""
    by_kind = grouped(messages, lambda message: str(message.kind.__name__))
    kinds = sorted(by_kind)
    for count in range(number):
        those = by_kind[kinds[count % len(kinds)]]
        message = those[mutator.below(len(those))]
        is_understood(message, mutator.mutate(message.payload), score)


def fuzz_sessions(messages: list[Overheard], number: int, mutator: Mutator, score: Score) -> None:
    """Let a stranger say so many mutated messages while jobs run; raises AssertionError when a result differs."""
    expected = comparable(calm())
    while score.sent < number:
        world = World(workers=2, seed=score.worlds, expected=2)
        stranger = bus_of(world, "stranger")
        cluster = world.store.cluster
        batch = min(PER_WORLD, number - score.sent)
        for beat in range(200):
            world.at(0.7 + 0.01 * beat, _burst(stranger, messages, cluster, mutator, score, -(-batch // 200)))
        assert comparable(world.run(CONFIG)) == expected, f"hostile messages changed the result of run {score.worlds}"
        score.rejects += world.service.rejects.total + sum(worker.rejects.total for worker in world.workers.values())
        score.worlds += 1
        world.close()


def calm() -> dict[str, Any]:
    """Return the result of the run that nobody disturbs."""
    world = World(workers=2, seed=0, expected=2)
    result: dict[str, Any] = world.run(CONFIG)
    world.close()
    return result


def _burst(
    stranger: Any, messages: list[Overheard], cluster: str, mutator: Mutator, score: Score, number: int
) -> Callable[[], None]:
    def say() -> None:
        for _ in range(number):
            message = messages[mutator.below(len(messages))]
            payload = mutator.mutate(message.payload)
            key = key_for(message, cluster, is_understood(message, payload, score), mutator)
            if key is not None:
                score.sent += 1
                if asked_kind(key) is not None and message.is_question:
                    stranger.get(key, payload, timeout_s=1.0)
                else:
                    stranger.put(key, payload)

    return say


def key_for(message: Overheard, cluster: str, understood: bool, mutator: Mutator) -> str | None:
    """Return a key on which the stranger can say this; None for what everybody may say and would be obeyed."""
    parts = message.key.split("/")
    if parts[1] != "hello":
        parts[1] = cluster
    if not understood:
        return "/".join(parts)
    if message.kind in (Greeting, ClientRequest, Control, GreetingAnswer, Answer, PullAnswer):
        return None
    if message.kind is Pull:
        return topics.worker(cluster, f"w{mutator.below(2)}", "pull")
    return topics.worker(cluster, "stranger", "report" if message.kind is EpochReport else "status")


def resident_mb() -> int:
    """Return the largest memory of this process so far, in MB."""
    scale = 1024 if sys.platform != "darwin" else 1024 * 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // scale


def lines(score: Score, seconds: float, before_mb: int) -> Iterator[str]:
    """Yield what was found."""
    kinds = sorted(score.refused.keys() | score.understood.keys())
    yield f"{'envelope':16} {'refused':>9} {'understood':>11}"
    for kind in kinds:
        yield f"{kind:16} {score.refused[kind]:9} {score.understood[kind]:11}"
    total = score.refused.total() + score.understood.total()
    yield f"{total} messages in {seconds:.0f} s, {score.sent} of them during {score.worlds} jobs; results equal"
    yield f"dropped by services: {score.rejects}; memory {before_mb} MB before, at most {resident_mb()} MB"


@program(
    "tests.simulation.hostile_messages",
    __doc__,
    option("--messages", type=int, default=100_000),
    option("--seed", type=int, default=0),
    prog=None,
    description=__doc__,
    formatter_class=argparse.RawDescriptionHelpFormatter,
)
def main(options: Namespace) -> int:
    """Run the benchmark."""
    logging.disable()
    messages, mutator, score = overhear(), Mutator(options.seed), Score()
    before, begin = resident_mb(), time.monotonic()
    in_sessions = options.messages // SESSION_SHARE
    fuzz_decoder(messages, options.messages - in_sessions, mutator, score)
    fuzz_sessions(messages, in_sessions, mutator, score)
    for line in lines(score, time.monotonic() - begin, before):
        say(line)
    return 0


if __name__ == "__main__":
    sys.exit(main())
