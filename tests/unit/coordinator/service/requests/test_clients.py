"""Clients' questions: each gets one answer, and what is wrong a sentence."""

import hashlib
from collections.abc import Callable, Iterator

import pytest

from atoll.config import JobConfig
from atoll.errors import StoreError
from atoll.wire.messages.clients import (
    Ask,
    Cancel,
    Delete,
    Deleted,
    Failure,
    GetResult,
    JobList,
    Jobs,
    JobStatus,
    Status,
    Submit,
    Upload,
    Uploaded,
    WorkerList,
    Workers,
)
from atoll_coordinator.service.controller import Controller
from atoll_coordinator.service.requests import clients as clients_module
from atoll_coordinator.service.requests.authorization import Authorization
from atoll_coordinator.service.requests.clients import ClientRequests
from atoll_coordinator.service.requests.deletion import JobDeletion
from atoll_coordinator.service.store.store import JobRecord, Store

TABLE = b"t,x\n0,1\n"
BLOB = hashlib.sha256(TABLE).hexdigest()


class Tasks:
    """Takes the place of channel and task runner, and records what is started, cancelled and sent."""

    def __init__(self) -> None:
        self.calls: list[tuple[object, ...]] = []

    def __getattr__(self, name: str) -> Callable[..., None]:
        return lambda *arguments: self.calls.append((name, *arguments))

    @property
    def prepared(self) -> list[tuple[object, ...]]:
        return [(job, table) for name, job, table, *_ in (call for call in self.calls if call[0] == "prepare")]


def controller_of(store: Store, tasks: Tasks, time: str = "2026-01-01T00:00:00") -> Controller:
    """Return a controller that reaches no workers and starts no processes."""
    return Controller(store, tasks, tasks, lambda: time)


@pytest.fixture
def tasks() -> Tasks:
    return Tasks()


@pytest.fixture
def clients(tasks: Tasks) -> Iterator[ClientRequests]:
    with Store.open(None) as store:
        controller = controller_of(store, tasks)
        deletion = JobDeletion(controller, store, lambda: "2026-01-01T00:00:00")
        yield ClientRequests(controller, store, Authorization(None, store), deletion, lambda: 5.0)


def chunk(data: bytes = TABLE, **changes: object) -> Ask:
    fields = {"blob": BLOB, "size": len(TABLE), "index": 0, "sha256": hashlib.sha256(data).hexdigest(), "data": data}
    return Ask(body=Upload.model_validate({**fields, **changes}))


def failure(answer: object) -> Failure:
    assert isinstance(answer, Failure)
    return answer


def test_a_table_is_uploaded_in_chunks_any_number_of_times(clients: ClientRequests) -> None:
    question = Ask(body=Upload(blob=BLOB, size=len(TABLE)))
    assert clients.answer("ann", question) == Uploaded(blob=BLOB, missing=(0,))
    for _ in range(2):
        assert clients.answer("ann", chunk()) == Uploaded(blob=BLOB, missing=())
    assert clients.answer("ann", question) == Uploaded(blob=BLOB, missing=())


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (chunk(sha256="0" * 64), "damaged"),
        (chunk(b"other"), "does not fit"),
        (chunk(index=1), "does not fit"),
        (chunk(blob="0" * 64), "digest"),
    ],
)
def test_chunks_that_are_not_what_they_claim_are_refused(clients: ClientRequests, ask: Ask, said: str) -> None:
    assert said in failure(clients.answer("ann", ask)).sentence


def test_an_upload_that_does_not_fit_the_store_is_refused(
    clients: ClientRequests, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clients_module, "MAX_STORED_BYTES", 5)
    answer = failure(clients.answer("ann", Ask(body=Upload(blob=BLOB, size=len(TABLE)))))
    assert "at most 5" in answer.sentence


def test_uploads_that_no_job_uses_make_room(clients: ClientRequests, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clients_module, "MAX_STORED_BYTES", len(TABLE))
    other = hashlib.sha256(b"left behind").hexdigest()
    clients._store.put_blob(b"left")
    clients._store.put_chunk(other, 11, 0, b"left behind")
    assert clients.answer("ann", chunk()) == Uploaded(blob=BLOB, missing=())
    clients.answer("ann", Ask(body=Submit(job="j", name="n", config=JobConfig(), table=BLOB)))
    sentence = failure(clients.answer("ann", Ask(body=Upload(blob=other, size=11)))).sentence
    assert "coordinator delete ID" in sentence


def test_an_ended_job_is_deleted_and_a_live_one_refused(clients: ClientRequests) -> None:
    clients.answer("ann", chunk())
    clients.answer("ann", Ask(body=Submit(job="j", name="n", config=JobConfig(), table=BLOB)))
    assert "cancel it" in failure(clients.answer("ann", Ask(body=Delete(job="j")))).sentence
    clients.answer("ann", Ask(body=Cancel(job="j")))
    for _ in range(2):
        assert clients.answer("ann", Ask(body=Delete(job="j"))) == Deleted(job="j")
    assert clients.answer("ann", Ask(body=Jobs())) == JobList(jobs=())
    assert not clients._store.has_blob(BLOB)


def test_a_submitted_job_is_prepared_and_listed(clients: ClientRequests, tasks: Tasks) -> None:
    clients.answer("ann", chunk())
    answer = clients.answer("ann", Ask(body=Submit(job="j", name="n", config=JobConfig(seed=3), table=BLOB)))
    assert isinstance(answer, JobStatus)
    assert (answer.job.state, answer.job.seed) == ("preparing", 3)
    assert tasks.prepared == [("j", TABLE)]
    listed = clients.answer("ann", Ask(body=Jobs()))
    assert isinstance(listed, JobList)
    assert [view.job for view in listed.jobs] == ["j"]
    assert failure(clients.answer("ann", Ask(body=GetResult(job="j")))).failure == "too-early"


def test_a_second_job_waits_for_its_turn_and_follows_when_the_first_has_ended(
    clients: ClientRequests, tasks: Tasks
) -> None:
    clients.answer("ann", chunk())
    for name in ("a", "b"):
        answer = clients.answer("ann", Ask(body=Submit(job=name, name="", config=JobConfig(), table=BLOB)))
    assert isinstance(answer, JobStatus)
    assert (answer.job.state, answer.job.reason) == ("queued", "waits for its turn (it is next; 1 job is under way)")
    cancelled = clients.answer("ann", Ask(body=Cancel(job="a")))
    assert isinstance(cancelled, JobStatus)
    assert cancelled.job.state == "cancelled"
    assert ("b", TABLE) in tasks.prepared
    assert ("cancel", "a") in tasks.calls  # it may be at work still
    assert "before its search began" in failure(clients.answer("ann", Ask(body=GetResult(job="a")))).sentence


def test_questions_about_unknown_jobs_say_so(clients: ClientRequests) -> None:
    for body in (Status(job="j"), GetResult(job="j"), Cancel(job="j")):
        assert failure(clients.answer("ann", Ask(body=body))).failure == "unknown-job"


def test_without_workers_the_list_is_empty(clients: ClientRequests) -> None:
    assert clients.answer("ann", Ask(body=Workers())) == WorkerList(workers=())


def test_a_stored_job_that_is_not_understood_fails_and_the_others_go_on(tasks: Tasks) -> None:
    with Store.open(None) as store:
        blob = store.put_blob(TABLE)
        for job, spec in (("old", '{"colour": "red"}'), ("torn", "{"), ("good", JobConfig(seed=3).model_dump_json())):
            store.add_job(JobRecord(job, job, spec, blob, "2026-01-01T00:00:00"))
        controller = controller_of(store, tasks, "2026-01-01T00:00:01")
        controller.recover(0.0)
        assert list(controller.jobs) == ["good"]
        for job, said in (("old", "colour"), ("torn", "JSON")):
            view = controller.view(job, 1.0)
            assert view is not None
            assert (view.state, store.jobs()[0].state) == ("failed", "failed")
            assert said in (view.reason or "")
        again = controller_of(store, tasks, "2026-01-01T00:00:02")
        again.recover(2.0)
        assert (list(again.jobs), sorted(again.ended)) == (["good"], ["old", "torn"])


def test_a_job_that_a_full_disk_kept_from_being_prepared_is_prepared_later(
    clients: ClientRequests, tasks: Tasks, monkeypatch: pytest.MonkeyPatch
) -> None:
    def is_full(*_: object, **__: object) -> bool:
        raise StoreError("the disk is full")

    clients.answer("ann", chunk())
    with monkeypatch.context() as full:
        full.setattr(Store, "update_job", is_full)
        ask = Ask(body=Submit(job="j", name="n", config=JobConfig(), table=BLOB))
        assert "full" in failure(clients.answer("ann", ask)).sentence
    assert tasks.prepared == []
    clients._controller.tick(6.0)
    assert tasks.prepared == [("j", TABLE)]


def test_a_cancellation_that_cannot_be_made_durable_ends_the_coordinator(
    clients: ClientRequests, monkeypatch: pytest.MonkeyPatch
) -> None:
    def is_full(*_: object, **__: object) -> bool:
        raise StoreError("the disk is full")

    clients.answer("ann", chunk())
    clients.answer("ann", Ask(body=Submit(job="j", name="n", config=JobConfig(), table=BLOB)))
    monkeypatch.setattr(Store, "update_job", is_full)
    with pytest.raises(StoreError, match="full"):
        clients.answer("ann", Ask(body=Cancel(job="j")))
