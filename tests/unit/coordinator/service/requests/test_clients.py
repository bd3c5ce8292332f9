"""Clients' questions: each gets one answer, and what is wrong a sentence."""

import hashlib
from collections.abc import Callable, Iterator

import pytest

from atoll_coordinator.service.job_controller import JobController
from atoll_coordinator.service.requests import clients as clients_module
from atoll_coordinator.service.requests import uploads as uploads_module
from atoll_coordinator.service.requests.authorization import Authorization
from atoll_coordinator.service.requests.clients import ClientRequests
from atoll_coordinator.service.requests.deletion import JobDeletion
from atoll_coordinator.service.scheduling.limits import Limits, Total
from atoll_coordinator.service.store.open_file import Room
from atoll_coordinator.service.store.store import JobRecord, Store
from atoll_coordinator.service.tasks.analyses import Analyses
from atoll_coordinator.service.tasks.background import JobPrepared, TableChecked
from atoll_core.config import JobConfig
from atoll_core.errors import StoreError
from atoll_core.wire.messages import clients as messages
from tests.blobs import put_blob

TABLE = b"t,x\n0,1\n"
BLOB = hashlib.sha256(TABLE).hexdigest()


class Tasks:
    """Takes the place of channel, background and tasks, and records what is started, cancelled and sent."""

    def __init__(self) -> None:
        self.calls: list[tuple[object, ...]] = []
        self.analyses = Analyses()
        self.controller: JobController | None = None

    def check_table(self, job: str, digest: str) -> None:
        """Find every table sound, at once."""
        if self.controller is not None:
            self.controller.take_outcome(TableChecked(job, True), Now.s)

    def __getattr__(self, name: str) -> Callable[..., None]:
        return lambda *arguments: self.calls.append((name, *arguments))

    def waiting_reason(self, job: str) -> None:
        """Return that nothing waits."""

    def views(self, job: str) -> tuple[()]:
        """Return that no task is under way."""
        return ()

    @property
    def prepared(self) -> list[tuple[object, ...]]:
        return [(job, table) for name, job, table, *_ in (call for call in self.calls if call[0] == "prepare")]


class Now:
    """The bus's seconds."""

    s = 5.0


def controller_of(store: Store, tasks: Tasks, time: str = "2026-01-01T00:00:00") -> JobController:
    """Return a controller that reaches no workers and starts no processes."""
    controller = JobController(store, tasks, tasks, lambda outcome: None, lambda: time)
    controller.tasks, tasks.controller = tasks, controller  # type: ignore[misc]
    return controller


@pytest.fixture
def tasks() -> Tasks:
    return Tasks()


@pytest.fixture
def clients(tasks: Tasks) -> Iterator[ClientRequests]:
    Now.s = 5.0
    with Store.open(None) as store:
        controller = controller_of(store, tasks)
        deletion = JobDeletion(controller, store)
        yield ClientRequests(controller, store, Authorization(None, store), deletion, lambda: Now.s)


def ask(clients: ClientRequests, body: messages.RequestBody, client: str = "ann") -> messages.AnswerBody:
    return clients.answer(client, messages.ClientRequest(body=body))


def chunk(data: bytes = TABLE, **changes: object) -> messages.ClientRequest:
    fields = {"blob": BLOB, "size": len(TABLE), "index": 0, "sha256": hashlib.sha256(data).hexdigest(), "data": data}
    return messages.ClientRequest(body=messages.Upload.model_validate({**fields, **changes}))


def failure(answer: object) -> messages.Failure:
    assert isinstance(answer, messages.Failure)
    return answer


def test_the_depth_of_the_queue_counts_a_job_that_was_submitted(clients: ClientRequests) -> None:
    empty = ask(clients, messages.GetQueueDepth(), "c")
    assert isinstance(empty, messages.QueueDepth)
    assert empty.workers_wanted == 0
    ask(clients, messages.Upload(blob=BLOB, size=len(TABLE), sha256=BLOB, data=TABLE), "c")
    ask(clients, messages.Submit(job="j", name="n", config=JobConfig(), table=BLOB), "c")
    depth = ask(clients, messages.GetQueueDepth(), "c")
    assert isinstance(depth, messages.QueueDepth)
    assert (depth.queued + depth.preparing, depth.workers_wanted) == (1, JobConfig().evolution.islands)


@pytest.mark.parametrize(
    ("upload", "said"),
    [
        (chunk(sha256="0" * 64), "damaged"),
        (chunk(b"other"), "does not fit"),
        (chunk(index=1), "does not fit"),
        (chunk(blob="0" * 64), "digest"),
    ],
)
def test_chunks_that_are_not_what_they_claim_are_refused(
    clients: ClientRequests, upload: messages.ClientRequest, said: str
) -> None:
    assert said in failure(clients.answer("ann", upload)).sentence


def test_uploads_that_were_given_up_make_room_and_those_that_go_on_do_not(
    clients: ClientRequests, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(uploads_module, "MAX_STORED_BYTES", len(TABLE))
    other = hashlib.sha256(b"left").hexdigest()
    clients.answer("bob", chunk())
    for _ in range(3):  # ann needs the room that bob takes, who goes on with his
        Now.s += uploads_module.LEASE_S - 1.0
        ask(clients, messages.Upload(blob=BLOB, size=len(TABLE)), "bob")
        assert "in 10 minutes" in failure(ask(clients, messages.Upload(blob=other, size=4))).sentence
        clients.uploads.expire()
        assert clients._store.has_blob(BLOB)
    Now.s += uploads_module.LEASE_S + 1.0
    assert ask(clients, messages.Upload(blob=other, size=4)) == messages.Uploaded(blob=other, missing=(0,))
    assert not clients._store.has_blob(BLOB)
    assert clients.answer("ann", chunk()) == messages.Uploaded(blob=BLOB, missing=())
    ask(clients, messages.Submit(job="j", name="n", config=JobConfig(), table=BLOB))
    sentence = failure(ask(clients, messages.Upload(blob=other, size=4))).sentence
    assert "coordinator delete ID" in sentence


def test_a_second_job_waits_for_its_turn_and_follows_when_the_first_has_ended(
    clients: ClientRequests, tasks: Tasks
) -> None:
    clients._controller.queue.limits = Limits(total=Total(running=1))
    clients.answer("ann", chunk())
    for name in ("a", "b"):
        answer = ask(clients, messages.Submit(job=name, name="", config=JobConfig(), table=BLOB))
    assert isinstance(answer, messages.JobStatus)
    assert (answer.job.state, answer.job.reason) == ("queued", "waits for its turn (it is next; 1 job is under way)")
    cancelled = ask(clients, messages.Cancel(job="a"))
    assert isinstance(cancelled, messages.JobStatus)
    assert cancelled.job.state == "cancelled"
    assert ("b", BLOB) in tasks.prepared
    assert ("cancel", "a") in tasks.calls  # it may be at work still
    assert "before its search began" in failure(ask(clients, messages.GetResult(job="a"))).sentence


def test_the_table_of_a_job_is_given_to_whoever_sees_the_job(clients: ClientRequests) -> None:
    clients.answer("ann", chunk())
    ask(clients, messages.Submit(job="j", name="n", config=JobConfig(), table=BLOB))
    answer = ask(clients, messages.GetTable(job="j"))
    assert answer == messages.TableChunk(job="j", index=0, size=len(TABLE), digest=BLOB, data=TABLE)
    assert "has no part 1" in failure(ask(clients, messages.GetTable(job="j", index=1))).sentence
    assert failure(ask(clients, messages.GetTable(job="none"))).failure == "unknown-job"


@pytest.mark.parametrize("is_deleted", [False, True])
def test_the_dataset_of_a_job_that_ended_while_it_was_prepared_is_not_kept(
    clients: ClientRequests, is_deleted: bool
) -> None:
    """Nobody would ever delete it."""
    clients.answer("ann", chunk())
    ask(clients, messages.Submit(job="j", name="n", config=JobConfig(), table=BLOB))
    ask(clients, messages.Cancel(job="j"))
    if is_deleted:
        ask(clients, messages.Delete(job="j"))
    controller, store = clients._controller, clients._store
    before = store.blob_bytes()
    store.keep_prepared("j", b"its dataset", b"the rest")
    controller.take_outcome(JobPrepared("j", None, b"", ""), 6.0)  # type: ignore[arg-type]
    assert store.blob_bytes() == before
    assert not store.has_blob(hashlib.sha256(b"its dataset").hexdigest())
    assert controller.jobs == {}


def test_a_page_of_jobs_is_no_larger_than_an_answer_bears(
    clients: ClientRequests, monkeypatch: pytest.MonkeyPatch
) -> None:
    clients.answer("ann", chunk())
    for name in "abc":
        ask(clients, messages.Submit(job=name, name="n" * 200, config=JobConfig(), table=BLOB))
    monkeypatch.setattr(clients_module, "MAX_PAGE_BYTES", 700)
    seen, before = [], None
    for _ in range(3):
        page = ask(clients, messages.ListJobs(before=before))
        assert isinstance(page, messages.JobList)
        seen += [view.job for view in page.jobs]
        before = page.before
    assert (seen, before) == (["c", "b", "a"], None)


def test_a_stored_job_that_is_not_understood_fails_and_the_others_go_on(tasks: Tasks) -> None:
    with Store.open(None) as store:
        blob = put_blob(store, TABLE)
        for job, spec in (("old", '{"colour": "red"}'), ("torn", "{"), ("good", JobConfig(seed=3).model_dump_json())):
            store.add_job(JobRecord(job, job, spec, blob, "2026-01-01T00:00:00"))
        controller = controller_of(store, tasks, "2026-01-01T00:00:01")
        controller.recover(0.0)
        assert list(controller.jobs) == ["good"]
        for job, said in (("old", "colour"), ("torn", "JSON")):
            view = controller.shown.view(job, 1.0)
            assert view is not None
            assert (view.state, store.jobs()[0].state) == ("failed", "failed")
            assert said in (view.reason or "")
        again = controller_of(store, tasks, "2026-01-01T00:00:02")
        again.recover(2.0)
        assert list(again.jobs) == ["good"]


def test_a_cancellation_that_cannot_be_made_durable_ends_the_coordinator(
    clients: ClientRequests, monkeypatch: pytest.MonkeyPatch
) -> None:
    def is_full(*_: object, **__: object) -> bool:
        raise StoreError("the disk is full")

    clients.answer("ann", chunk())
    ask(clients, messages.Submit(job="j", name="n", config=JobConfig(), table=BLOB))
    monkeypatch.setattr(Store, "update_job", is_full)
    with pytest.raises(StoreError, match="full"):
        ask(clients, messages.Cancel(job="j"))


# ---------------------------------------------------------------------------------------- a disk nearly full

MB = 1024**2


def test_an_upload_that_would_fill_the_disk_is_refused_in_one_sentence(
    clients: ClientRequests, monkeypatch: pytest.MonkeyPatch
) -> None:
    room = Room(15 * MB + len(TABLE) - 1, 60 * MB)
    monkeypatch.setattr(Store, "room", lambda self: room)
    refused = failure(clients.answer("ann", chunk()))
    assert refused.failure == "refused"
    assert refused.sentence.startswith(
        f"the coordinator's disk has {15 * MB + 7} free bytes, of which {15 * MB} are reserved"
    )
    room = Room(15 * MB + len(TABLE), 60 * MB)
    assert isinstance(clients.answer("ann", chunk()), messages.Uploaded)
    room = Room(0, 60 * MB)  # what is there is not refused
    assert isinstance(clients.answer("ann", chunk()), messages.Uploaded)


def test_on_a_disk_nearly_full_uploads_that_no_job_uses_go_first(
    clients: ClientRequests, monkeypatch: pytest.MonkeyPatch
) -> None:
    room = Room(15 * MB, 60 * MB)
    monkeypatch.setattr(Store, "room", lambda self: room)
    store = clients._store
    used, unused = put_blob(store, b"used"), put_blob(store, b"unused")
    store.add_job(JobRecord("job", "", JobConfig().model_dump_json(), used, "2026"))
    clients.uploads.expire()
    assert store.has_blob(unused)
    room = Room(7 * MB, 60 * MB)
    clients.uploads.expire()
    assert not store.has_blob(unused)
    assert store.has_blob(used)
