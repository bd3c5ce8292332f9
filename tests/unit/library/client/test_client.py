"""The client: what it asks, what it understands, and that it never waits for ever."""

import hashlib
from collections.abc import Callable

import pytest

from atoll.client.client import ANSWER_LIMIT_S, IDLE_LIMIT_S, Client
from atoll_core.config import JobConfig
from atoll_core.errors import AtollError, DataError, RefusedError, UnreachableError
from atoll_core.wire.bus.interface import Event, Message, Reply
from atoll_core.wire.codec import decode, encode
from atoll_core.wire.messages.clients import (
    AnalysisAnswer,
    Answer,
    AskAnalysis,
    Cancel,
    ClientRequest,
    Failure,
    FailureKind,
    GetResult,
    JobList,
    JobStatus,
    ListJobs,
    ListWorkers,
    ResultText,
    Status,
    Submit,
    Upload,
    Uploaded,
    WorkerList,
)
from atoll_core.wire.messages.handshake import GreetingAnswer, Refusal, Welcome
from atoll_core.wire.messages.limits import CHUNK_SIZE
from tests.views import job_view

Body = Upload | Submit | ListJobs | Status | ListWorkers | GetResult | Cancel | AskAnalysis
AnswerBody = Uploaded | JobList | JobStatus | WorkerList | ResultText | Failure | AnalysisAnswer
WELCOME = Welcome(realm="r1", incarnation=1, protocol=1, version="0.1.0", engine=1)


class AnsweringBus:
    """A bus on which `answer` replies at once to every question; virtual time passes only in `receive`."""

    def __init__(self, answer: Callable[[str, bytes], bytes | None]) -> None:
        self._answer = answer
        self._events: list[Event] = []
        self._now = 0.0
        self.keys: list[str] = []

    def get(self, key: str, payload: bytes = b"", timeout_s: float = 5.0) -> int:
        self.keys.append(key)
        self._events += [Message("atoll/noise", b""), Reply(len(self.keys), self._answer(key, payload))]
        return len(self.keys)

    def receive(self, timeout_s: float) -> Event | None:
        if self._events:
            return self._events.pop(0)
        self._now += timeout_s
        return None

    def now(self) -> float:
        return self._now


def client_with(handle: Callable[[Body], AnswerBody | None]) -> tuple[Client, AnsweringBus]:
    def answer(key: str, payload: bytes) -> bytes | None:
        if key.startswith("atoll/hello/client-"):
            return encode(GreetingAnswer(body=WELCOME))
        body = handle(decode(payload, ClientRequest).body)
        return None if body is None else encode(Answer(body=body))

    bus = AnsweringBus(answer)
    return Client(bus, "tcp/there:7447"), bus  # type: ignore[arg-type]


def test_an_upload_goes_by_what_the_coordinator_says_is_missing() -> None:
    """One whose chunks were deleted meanwhile is sent again; one that is never kept is given up."""
    data = bytes(range(256)) * (CHUNK_SIZE // 128)
    told = iter([(0, 1), (1,), (0, 1), (1,), ()])
    sent: list[int] = []

    def handle(body: Body) -> AnswerBody:
        assert isinstance(body, Upload)
        sent.extend([body.index] if body.data is not None else [])
        return Uploaded(blob=body.blob, missing=next(told, (0, 1)))

    client, _ = client_with(handle)
    client.upload(data)
    assert sent == [0, 1, 0, 1]
    with pytest.raises(RefusedError, match="does not keep the uploaded data: 2 of 2 parts are still missing"):
        client.upload(data)


def test_a_table_that_was_deleted_before_its_job_came_is_uploaded_again() -> None:
    seen: list[str] = []

    def handle(body: Body) -> AnswerBody:
        seen.append(body.kind)
        if isinstance(body, Upload):
            return Uploaded(blob=body.blob, missing=())
        if seen.count("submit") == 1:
            return Failure(failure="no-table", sentence="the table of job j1 has not been uploaded")
        return JobStatus(job=job_view(job="j1"))

    client, _ = client_with(handle)
    assert client.hand_in("j1", "name", JobConfig(), b"t,x").job == "j1"
    assert seen == ["upload", "submit", "upload", "submit"]


def test_a_table_that_was_deleted_while_its_question_waits_is_uploaded_again() -> None:
    """As a coordinator does that is started again; where it is never kept, the question ends."""
    seen: list[str] = []
    forgets = False

    def handle(body: Body) -> AnswerBody:
        seen.append(body.kind)
        if isinstance(body, Upload):
            return Uploaded(blob=body.blob, missing=())
        if forgets or seen.count("analyse") == 2:
            return Failure(failure="no-table", sentence="the table of the question has not been uploaded")
        if seen.count("analyse") == 1:
            return AnalysisAnswer(job="j1", waits_for="waits for a worker")
        return AnalysisAnswer(job="j1", data=b"{}", size=2, digest=hashlib.sha256(b"{}").hexdigest())

    client, _ = client_with(handle)
    assert client.analyse("j1", "report", b"{}", b"t,x") == b"{}"
    assert seen == ["upload", "analyse", "analyse", "upload", "analyse"]
    forgets = True
    with pytest.raises(RefusedError, match="has not been uploaded"):
        client.analyse("j1", "report", b"{}", b"t,x")


@pytest.mark.parametrize(
    ("failure", "error", "code"),
    [
        ("unknown-job", RefusedError, 2),
        ("data", DataError, 2),
        ("too-early", RefusedError, 2),
        ("internal", AtollError, 1),
    ],
)
def test_a_failure_raises_the_error_with_its_exit_code(
    failure: FailureKind, error: type[AtollError], code: int
) -> None:
    client, _ = client_with(lambda body: Failure(failure=failure, sentence="so it is"))
    with pytest.raises(error, match="so it is") as caught:
        client.status("j1")
    assert caught.value.exit_code == code


def test_silence_ends_in_an_error_that_says_what_was_waited_for() -> None:
    client, bus = client_with(lambda body: None)
    with pytest.raises(UnreachableError, match="the status of job j1") as caught:
        client.status("j1")
    assert "tcp/there:7447" in str(caught.value)
    assert caught.value.exit_code == 3
    assert bus.now() <= ANSWER_LIMIT_S + 0.01


def test_a_refusal_says_why() -> None:
    refusal = Refusal(protocol=9, version="9.0", engine=9, sentence="client has 0.1.0, coordinator 9.0")
    client = Client(AnsweringBus(lambda key, payload: encode(GreetingAnswer(body=refusal))), "tcp/x:1")  # type: ignore[arg-type]
    with pytest.raises(RefusedError, match=r"coordinator 9\.0"):
        client.jobs()


def test_an_answer_that_is_not_in_our_words_is_refused() -> None:
    client = Client(AnsweringBus(lambda key, payload: b"\xc1garbage"), "tcp/x:1")  # type: ignore[arg-type]
    with pytest.raises(RefusedError, match="not understood"):
        client.jobs()
    other, _ = client_with(lambda body: WorkerList(workers=()))
    with pytest.raises(RefusedError, match="worker-list"):
        other.jobs()


def test_the_beginning_of_an_id_is_looked_up_by_the_coordinator() -> None:
    client, _ = client_with(lambda body: JobStatus(job=job_view(job="abc1")))
    assert client.resolve("abc") == "abc1"
    with pytest.raises(RefusedError, match="no job 'a/b': ids are 1 to 64 letters"):
        client.resolve("a/b")
    assert client.jobs("a/b") == ()


def test_jobs_are_listed_page_by_page() -> None:
    asked: list[ListJobs] = []
    ids = [f"j{number}" for number in range(7)]

    def handle(body: Body) -> AnswerBody:
        assert isinstance(body, ListJobs)
        asked.append(body)
        end = len(ids) if body.before is None else body.before
        start = max(0, end - min(body.limit, 3))
        return JobList(jobs=tuple(job_view(job=name) for name in ids[start:end]), before=start or None)

    client, _ = client_with(handle)
    assert [view.job for view in client.jobs()] == ids
    assert len(asked) == 3
    assert [view.job for view in client.jobs(last=4)] == ids[-4:]
    assert [request.limit for request in asked[3:]] == [4, 1]


ANSWER = b"12345"


def part(index: int, data: bytes, digest: str = hashlib.sha256(ANSWER).hexdigest()) -> AnalysisAnswer:
    return AnalysisAnswer(job="j1", index=index, size=5, digest=digest, data=data)


def test_an_analysis_is_asked_for_until_it_is_there_and_fetched_part_by_part() -> None:
    pending, made = AnalysisAnswer(job="j1", waits_for="waits for a worker"), AnalysisAnswer(job="j1")
    answers = [pending, pending, made, part(0, b"123"), made, part(0, b"123"), part(1, b"45")]  # lost once meanwhile
    asked: list[int] = []
    said: list[str] = []

    def handle(body: Body) -> AnswerBody:
        assert isinstance(body, AskAnalysis)
        asked.append(body.index)
        return answers.pop(0)

    client, _ = client_with(handle)
    assert client.analyse("j1", "report", b"q", report_wait=said.append) == ANSWER
    assert asked == [0, 0, 0, 0, 1, 0, 1]
    assert said == ["waits for a worker"]


def test_an_analysis_that_was_damaged_or_that_nobody_begins_is_refused() -> None:
    client, _ = client_with(lambda body: part(0, ANSWER, "0" * 64))
    with pytest.raises(RefusedError, match="damaged on the network"):
        client.analyse("j1", "report", b"q")
    client, bus = client_with(lambda body: AnalysisAnswer(job="j1", waits_for="waits for a worker"))
    with pytest.raises(UnreachableError, match="job j1 was not begun within 3600 s: it waits for a worker"):
        client.analyse("j1", "report", b"q")
    assert IDLE_LIMIT_S < bus.now() < IDLE_LIMIT_S + ANSWER_LIMIT_S
