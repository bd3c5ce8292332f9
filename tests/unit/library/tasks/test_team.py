"""Batches of a task, computed here and by helpers who ask: the same results come of it, whoever computes what."""

import hashlib
import threading

import pytest

from atoll.tasks import process as module
from atoll.tasks.process import NOTED_S, Team, compute
from atoll_coordinator.model.batches import CANCELLED, FUNCTIONS
from atoll_core.task_frames import Ask, FromProcess, Give, Progressed, TaskBatch

LIMIT_S = 60.0
TASK = "t" * 64
CONTEXT = b"a context"
DIGEST = hashlib.sha256(CONTEXT).hexdigest()
ITEMS = [b"%d" % number for number in range(12)]


def made(context: bytes, item: bytes) -> bytes:
    return context + b":" + item


EXPECTED = [made(CONTEXT, item) for item in ITEMS]


class Said:
    """What a team says, by token."""

    def __init__(self) -> None:
        self.gave: list[Give] = []
        self.changed = threading.Condition()

    def __call__(self, message: FromProcess) -> None:
        assert isinstance(message, Give)
        with self.changed:
            self.gave.append(message)
            self.changed.notify_all()

    def answer_to(self, token: int) -> TaskBatch | None:
        with self.changed:
            assert self.changed.wait_for(lambda: any(one.token == token for one in self.gave), LIMIT_S)
            return next(one.batch for one in self.gave if one.token == token)


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def said() -> Said:
    return Said()


@pytest.fixture(autouse=True)
def _functions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(FUNCTIONS, "test: made", made)


def here_gated(monkeypatch: pytest.MonkeyPatch, gate: threading.Event, entered: threading.Event) -> None:
    """Have what is computed here wait for the gate."""

    def computed(function: str, context: bytes, item: bytes) -> bytes:
        entered.set()
        assert gate.wait(LIMIT_S)
        return FUNCTIONS[function](context, item)

    monkeypatch.setattr(module, "_computed", computed)


class Mapping(threading.Thread):
    """A thread of a task that calls `Team.map`."""

    def __init__(
        self, team: Team, items: list[bytes], context: bytes = CONTEXT, cancel_after: float | None = None
    ) -> None:
        super().__init__(daemon=True)
        self._call = (team, items, context, cancel_after)
        self.result: list[bytes] = []
        self.start()

    def run(self) -> None:
        team, items, context, cancel_after = self._call
        self.result = team.map("test: made", context, items, cancel_after)

    def ended(self) -> list[bytes]:
        self.join(LIMIT_S)
        assert not self.is_alive()
        return self.result


def test_without_helpers_all_is_computed_here_in_order(said: Said) -> None:
    team = Team(said)
    assert team.workers == 0
    assert team.map("test: made", CONTEXT, ITEMS) == EXPECTED
    assert team.map("test: made", CONTEXT, []) == []
    assert said.gave == []


def test_a_helper_that_asked_before_gets_the_last_batch_and_its_answer_counts(
    said: Said, monkeypatch: pytest.MonkeyPatch
) -> None:
    team, gate, entered = Team(said), threading.Event(), threading.Event()
    here_gated(monkeypatch, gate, entered)
    team.ask(Ask(1))
    assert team.workers == 1
    mapping = Mapping(team, ITEMS)
    batch = said.answer_to(1)
    assert batch is not None
    assert (batch.digest, batch.context, batch.item) == (DIGEST, CONTEXT, ITEMS[-1])
    team.take(batch.number, b"made elsewhere")
    gate.set()
    assert mapping.ended() == [*EXPECTED[:-1], b"made elsewhere"]


def test_two_threads_and_many_helpers_have_all_computed(said: Said) -> None:
    team = Team(said)
    items = [b"%d" % number for number in range(300)]
    stop = threading.Event()

    def help_on(first: int) -> None:
        for token in range(first, first + 100_000):
            if stop.is_set():
                return
            team.ask(Ask(token))
            while not stop.is_set():
                with said.changed:
                    answers = [one for one in said.gave if one.token == token]
                    if not answers:
                        said.changed.wait(0.01)
                        continue
                batch = answers[0].batch
                if batch is not None:
                    team.take(batch.number, compute(batch).result)
                break

    helpers = [threading.Thread(target=help_on, args=(number * 1_000_000,), daemon=True) for number in range(3)]
    for helper in helpers:
        helper.start()
    threads = [Mapping(team, items, context) for context in (b"one", b"two")]
    results = [thread.ended() for thread in threads]
    stop.set()
    for helper in helpers:
        helper.join(LIMIT_S)
    assert results == [[made(context, item) for item in items] for context in (b"one", b"two")]


def test_what_a_straggler_has_is_computed_here_as_well(said: Said) -> None:
    team = Team(said)
    team.ask(Ask(1))
    mapping = Mapping(team, ITEMS)
    batch = said.answer_to(1)
    assert mapping.ended() == EXPECTED  # though it never came back
    assert batch is not None
    team.take(batch.number, b"too late")
    assert team.map("test: made", CONTEXT, ITEMS) == EXPECTED


def test_a_batch_that_could_not_be_made_is_made_here_and_not_given_away_again(
    said: Said, monkeypatch: pytest.MonkeyPatch
) -> None:
    team, gate, entered = Team(said), threading.Event(), threading.Event()
    here_gated(monkeypatch, gate, entered)
    mapping = Mapping(team, ITEMS)
    assert entered.wait(LIMIT_S)
    team.ask(Ask(1))
    broken = said.answer_to(1)
    assert broken is not None
    team.take(broken.number, None)
    team.ask(Ask(2))
    other = said.answer_to(2)
    assert other is not None
    assert other.number != broken.number
    gate.set()
    assert mapping.ended() == EXPECTED


def test_what_breaks_in_a_batch_breaks_the_call_here_and_is_none_elsewhere(
    said: Said, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def breaks(context: bytes, item: bytes) -> bytes:
        raise ValueError("planted")

    monkeypatch.setitem(FUNCTIONS, "test: made", breaks)
    team = Team(said)
    with pytest.raises(ValueError, match="planted"):
        team.map("test: made", CONTEXT, ITEMS)
    assert compute(TaskBatch(1, "test: made", DIGEST, CONTEXT, b"")).result is None
    assert "a batch failed" in caplog.text
    team.ask(Ask(1))
    team.end()
    assert said.answer_to(1) is None  # the call that broke has no batches to give any more


def test_a_batch_for_which_memory_does_not_suffice_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def exhausts(context: bytes, item: bytes) -> bytes:
        raise MemoryError

    monkeypatch.setitem(FUNCTIONS, "test: made", exhausts)
    computed = compute(TaskBatch(1, "test: made", DIGEST, CONTEXT, b""))
    assert (computed.result, computed.failure) == (None, "memory")


def test_the_end_of_a_task_answers_who_waits(said: Said) -> None:
    team = Team(said)
    team.ask(Ask(1))
    team.ask(Ask(2))
    team.end()
    assert said.gave == [Give(1, None), Give(2, None)]
    assert team.workers == 0


def test_the_worker_is_told_how_many_candidates_were_compared_now_and_then() -> None:
    told: list[FromProcess] = []
    clock = Clock()
    team = Team(told.append, clock)
    for task in (TASK, "u" * 64):
        team.begin(task, 1)
        told.clear()
        for _ in range(5):
            team.note(2)
        assert told == [], "a heartbeat has no use for more"
        clock.now += NOTED_S
        team.note(1)
        team.note(1)
        assert told == [Progressed(task, 11)]
        assert team.counts["compared"] == 12


def test_what_has_not_come_in_time_is_cancelled(said: Said, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()
    team = Team(said, clock)

    def computed(function: str, context: bytes, item: bytes) -> bytes:
        clock.now += 1.0
        return FUNCTIONS[function](context, item)

    monkeypatch.setattr(module, "_computed", computed)
    assert team.map("test: made", CONTEXT, ITEMS, 3.0) == [*EXPECTED[:3], *[CANCELLED] * (len(ITEMS) - 3)]


def test_batches_that_are_too_large_for_a_message_are_computed_here(
    said: Said, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MAX_BATCH", len(CONTEXT))
    team = Team(said)
    team.ask(Ask(1))
    assert team.map("test: made", CONTEXT, ITEMS) == EXPECTED
    assert said.gave == []
