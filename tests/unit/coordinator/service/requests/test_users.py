"""Users beside each other: what each sees, may do, store and have wait."""

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import pytest

from atoll_coordinator.service.job_controller import JobController
from atoll_coordinator.service.monitoring.followers import Followers
from atoll_coordinator.service.requests import admission, uploads
from atoll_coordinator.service.requests.authorization import Authorization
from atoll_coordinator.service.requests.clients import ClientRequests
from atoll_coordinator.service.requests.deletion import JobDeletion
from atoll_coordinator.service.requests.uploads import CHECK_INTERVAL_S, LEASE_S
from atoll_coordinator.service.scheduling.limits import Allowance, Limits, Times, Total
from atoll_coordinator.service.store.backup import back_up, restore
from atoll_coordinator.service.store.retention import KEEP_ALL, Retention
from atoll_coordinator.service.store.store import Store
from atoll_core.config import BudgetConfig, JobConfig
from atoll_core.wire.codec import decode
from atoll_core.wire.messages import clients as messages
from atoll_core.wire.messages.clients import (
    ClientRequest,
    Deleted,
    EventList,
    Failure,
    Following,
    JobChange,
    JobList,
    JobStatus,
)
from atoll_core.wire.messages.handshake import Hello
from atoll_core.wire.messages.limits import CHUNK_SIZE
from atoll_core.wire.messages.views import CoordinatorView, Counters, UserView, Workforce
from atoll_core.wire.security.roles import RoleBindings
from tests.unit.coordinator.service.requests.test_clients import Tasks, controller_of

ROLES = RoleBindings({
    "ann": "submitter", "bob": "submitter", "eve": "admin", "lab1": "worker", "mal": "revoked",
})  # fmt: skip
NOW = 5.0


class Lab:
    """A coordinator with a roster, and users who ask it."""

    def __init__(
        self, store: Store, roles: RoleBindings | None = ROLES, retention: Retention = KEEP_ALL
    ) -> None:  # fmt: skip
        self.store = store
        self.now = NOW
        self.controller: JobController = controller_of(store, Tasks())
        self.controller.recover(NOW)
        self.authorization = Authorization(roles, store)
        deletion = JobDeletion(self.controller, store, retention)
        self.told: list[tuple[str, JobChange]] = []
        self.followers = Followers(
            1, self.controller.shown, self.controller.events, lambda now: Workforce(),
            lambda client, payload: self.told.append((client, decode(payload, JobChange))),
        )  # fmt: skip
        self.controller.changed = self.followers.touch
        self.controller.events.on_event = lambda kind, job: self.followers.touch(job)
        self.users: tuple[UserView, ...] = ()
        self.clients = ClientRequests(
            self.controller, store, self.authorization, deletion, lambda: self.now, self.coordinator, self.followers
        )

    def coordinator(self) -> CoordinatorView:
        counters, timing = Counters(), self.store.timing()
        return CoordinatorView(
            version="1", incarnation=1, seconds=1.0, counters=counters, store=timing, users=self.users
        )

    def ask(self, user: str, body: object) -> object:
        return self.clients.answer(f"{user}-1", ClientRequest.model_validate({"body": body}))

    def upload(self, user: str, table: bytes) -> object:
        digest = hashlib.sha256(table).hexdigest()
        return self.ask(user, messages.Upload(blob=digest, size=len(table), index=0, sha256=digest, data=table))

    def submit(self, user: str, job: str, table: bytes = b"t,x\n", **changes: object) -> object:
        answer = self.upload(user, table)
        if isinstance(answer, Failure):
            return answer
        fields = {"job": job, "name": "n", "config": JobConfig(), "table": hashlib.sha256(table).hexdigest()}
        return self.ask(user, messages.Submit.model_validate({**fields, **changes}))

    def follow(self, user: str, job: str | None = None) -> object:
        return self.ask(user, messages.Follow(job=job, after=0))

    def heard(self) -> set[tuple[str, str | None]]:
        """Return who has been told of which jobs since the last call."""
        self.followers.notify(NOW + 100.0)
        told, self.told[:] = [*self.told], []
        return {(client, event.job) for client, change in told for event in change.events}

    def seen(self, user: str) -> list[str]:
        answer = self.ask(user, messages.ListJobs())
        assert isinstance(answer, JobList)
        return [view.job for view in answer.jobs]

    def fail(self, job: str) -> None:
        self.controller.fail_job(job, "internal", "it was to fail", NOW)


@pytest.fixture
def lab() -> Iterator[Lab]:
    with Store.open(None) as store:
        yield Lab(store)


def said(answer: object) -> str:
    assert isinstance(answer, Failure), answer
    return answer.sentence


def view(answer: object) -> messages.JobView:
    assert isinstance(answer, JobStatus), answer
    return answer.job


# ------------------------------------------------------------------------------------------------ privacy


def check_hidden(lab: Lab, job: str, user: str) -> None:
    """Check that every question of a user about a job is answered as one about a job that there is not."""
    (union,) = (get_args(field.annotation) for field in [ClientRequest.model_fields["body"]])
    asked = 0
    for kind in union:
        if "job" not in kind.model_fields or kind is messages.Submit:
            continue
        values = {"job": job, "priority": 1, "again": "other", "function": "report", "question": b"q"}
        values = {name: value for name, value in values.items() if name in kind.model_fields}
        about_it, about_none = (lab.ask(user, kind(**{**values, "job": name})) for name in (job, "none"))
        assert about_it.model_dump_json().replace(job, "none") == about_none.model_dump_json(), kind
        asked += 1
    assert asked >= 8


def test_a_job_is_seen_by_all_as_long_as_it_is_shared(lab: Lab) -> None:
    lab.submit("ann", "mine", shared=True)
    assert lab.seen("bob") == ["mine"]
    assert view(lab.ask("bob", messages.Status(job="mine"))).shared
    lab.ask("ann", messages.Share(job="mine", shared=False))
    assert lab.seen("bob") == []
    lab.ask("ann", messages.Cancel(job="mine"))
    assert view(lab.ask("eve", messages.Share(job="mine"))).shared
    assert lab.seen("bob") == ["mine"]


@pytest.fixture(params=["restart", "restore"])
def later(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Lab]:
    """A coordinator that was started again, or serves what was restored from a copy: ann has a private job, one that
    is shared, one that has ended and one that was deleted, and bob one of his own."""
    with Store.open(tmp_path / "state") as store:
        lab = Lab(store)
        for job in ("mine", "shared", "ended", "deleted"):
            lab.submit("ann", job, job.encode(), shared=job == "shared")
        for job in ("ended", "deleted"):
            lab.ask("ann", messages.Cancel(job=job))
        lab.ask("ann", messages.Delete(job="deleted"))
        lab.submit("bob", "his", b"his")
        lab.controller.events.flush()
    state = tmp_path / "state"
    if request.param == "restore":
        back_up(state, tmp_path / "copy")
        state = tmp_path / "restored"
        restore(tmp_path / "copy", state)
    with Store.open(state) as store:
        yield Lab(store)


def test_after_a_restart_and_a_restore_each_job_is_seen_by_the_same_users(later: Lab) -> None:
    check_hidden(later, "mine", "bob")
    check_hidden(later, "ended", "bob")
    hidden, none = (said(later.ask("bob", messages.FindJob(prefix=prefix))) for prefix in ("mi", "no"))
    assert hidden == none.replace("'no'", "'mi'")
    assert later.seen("bob") == ["shared", "his"]
    assert later.seen("ann") == ["mine", "shared", "ended"]
    assert later.seen("eve") == ["mine", "shared", "ended", "his"]
    for user, jobs in (
        ("bob", {"shared", "his"}), ("ann", {"mine", "shared", "ended"}),
        ("eve", {"mine", "shared", "ended", "his"}),
    ):  # fmt: skip
        events = later.ask(user, messages.GetEvents())
        assert isinstance(events, EventList)
        assert {event.job for event in events.events} - {None} == jobs
        assert ("job deleted is deleted" in events.model_dump_json()) == (user == "eve")
    stolen = later.ask(
        "bob", messages.Submit(job="new", name="", config=JobConfig(), table=hashlib.sha256(b"mine").hexdigest())
    )
    assert isinstance(stolen, Failure)
    assert stolen.failure == "no-table"


def test_after_a_restart_and_a_restore_each_job_is_changed_by_the_same_users(later: Lab) -> None:
    before = {record.id: record for record in later.store.jobs()}
    for body in (
        messages.Cancel(job="shared"), messages.Pause(job="shared"), messages.SetPriority(job="shared", priority=3),
        messages.Share(job="shared", shared=False), messages.Retry(job="shared", again="x"),
        messages.Delete(job="shared"),
    ):  # fmt: skip
        assert "was submitted by ann; only ann or an admin may" in said(later.ask("bob", body))
    for body in (messages.SetQueue(paused=True), messages.SetWorker(worker="w", service="draining")):
        assert "only an admin" in said(later.ask("ann", body))
    assert {record.id: record for record in later.store.jobs()} == before
    assert view(later.ask("ann", messages.SetPriority(job="shared", priority=3))).priority == 3
    assert view(later.ask("eve", messages.Cancel(job="mine"))).state == "cancelled"


def test_submitters_are_told_how_many_jobs_of_their_own_wait_and_admins_of_all(lab: Lab) -> None:
    ann, bob, nobody = (UserView(user=user, queued=2) for user in ("ann", "bob", None))
    lab.users = (ann, bob, nobody)
    seen = {user: lab.ask(user, messages.ListWorkers()).coordinator.users for user in ("ann", "eve")}
    assert seen == {"ann": (ann,), "eve": lab.users}


def test_whoever_knows_a_digest_alone_has_not_the_table(lab: Lab) -> None:
    lab.submit("ann", "mine", b"secret")
    digest = hashlib.sha256(b"secret").hexdigest()
    asked = lab.ask("bob", messages.Upload(blob=digest, size=6))
    assert asked == messages.Uploaded(blob=digest, missing=(0,))
    stolen = lab.ask("bob", messages.Submit(job="his", name="", config=JobConfig(), table=digest))
    assert isinstance(stolen, Failure)
    assert stolen.failure == "no-table"
    wrong = hashlib.sha256(b"guess!").hexdigest()
    guesses = [
        said(lab.ask("bob", messages.Upload(blob=blob, size=6, index=0, sha256=wrong, data=b"guess!")))
        for blob in (digest, "0" * 64)
    ]
    assert guesses[0] == guesses[1].replace("0" * 64, digest)
    assert lab.upload("bob", b"secret") == messages.Uploaded(blob=digest, missing=())
    assert view(lab.submit("bob", "his", b"secret")).submitter == "bob"


def part(table: bytes, index: int, **changes: object) -> messages.Upload:
    """Return the upload of a chunk of a table."""
    data = table[index * CHUNK_SIZE : (index + 1) * CHUNK_SIZE]
    fields = {"blob": hashlib.sha256(table).hexdigest(), "size": len(table), "index": index, "data": data}
    return messages.Upload.model_validate({**fields, "sha256": hashlib.sha256(data).hexdigest(), **changes})


def test_a_question_is_not_about_a_table_that_another_session_uploaded(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where no name is proved, a table that no job uses yet belongs to the session that has shown all of it."""
    lab.submit("ann", "mine")
    lab.fail("mine")
    monkeypatch.setattr(lab.authorization, "submitter", lambda client: None)
    lab.upload("ann", b"private")
    question = messages.AskAnalysis(
        job="mine", function="analyse", question=b"q", table=hashlib.sha256(b"private").hexdigest()
    )  # fmt: skip
    monkeypatch.setattr(lab.authorization, "hides", lambda client, request: None)
    assert "has not been uploaded" in said(lab.ask("bob", question))
    assert "ended without a result" in said(lab.ask("ann", question))


def test_what_is_announced_takes_no_room_and_what_is_stored_counts(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    size = 1024**3
    for number in range(20):  # more than the store takes, and one byte of each
        last = {"size": size + 1, "index": size // CHUNK_SIZE, "data": b"x"}
        digest = {"blob": f"{number:064}", "sha256": hashlib.sha256(b"x").hexdigest()}
        lab.ask("bob", messages.Upload.model_construct(**digest, **last))
        lab.ask("bob", messages.Upload(blob=f"{number:064}", size=size))
    assert lab.store.blob_bytes() == 0
    assert not isinstance(lab.upload("ann", b"t,x"), Failure)
    monkeypatch.setattr(admission, "RESULT_RESERVE", 10)
    limit(lab, user=Allowance(stored=CHUNK_SIZE + 100))
    table = bytes(CHUNK_SIZE + 50)
    lab.ask("eve", messages.Upload(blob=part(table, 0).blob, size=3))
    lab.ask("eve", part(table, 0))
    assert lab.clients.uploads.pending_bytes("eve", "", "eve-1")[0] == lab.store.blob_bytes() - 3 == CHUNK_SIZE
    assert "exceed the" in said(lab.upload("eve", bytes(91)))


def test_tables_of_few_bytes_are_bounded_by_their_number(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uploads, "MOST_OF_USER", 3)
    monkeypatch.setattr(uploads, "MOST_OF_ALL", 5)
    for number in range(3):
        assert not isinstance(lab.upload("ann", b"%d" % number), Failure)
    assert "uploaded 3 tables without submitting" in said(lab.upload("ann", b"3"))
    assert not isinstance(lab.upload("ann", b"0"), Failure), "it is there"
    lab.submit("ann", "a", b"0")
    assert not isinstance(lab.upload("ann", b"3"), Failure)
    for number in range(2):
        assert not isinstance(lab.upload("bob", b"b%d" % number), Failure)
    assert "all users: 5" in said(lab.upload("eve", b"e"))
    lab.now += LEASE_S + CHECK_INTERVAL_S
    lab.clients.uploads.expire()
    assert not isinstance(lab.upload("eve", b"e"), Failure)


def test_jobs_from_before_a_roster_are_those_of_admins(lab: Lab) -> None:
    """Nobody proved whose they were: whoever has a certificate now is not to see, end or delete them."""
    store = lab.store
    before = Lab(store, None)
    for job in ("old", "open", "ended"):
        before.submit("x", job)
    before.ask("x", messages.Cancel(job="ended"))
    before.ask("x", messages.Share(job="open"))
    jobs = lab.ask("ann", messages.ListJobs())
    assert isinstance(jobs, JobList)
    assert [job.job for job in jobs.jobs] == ["open"], "what was shared stays so"
    for job in ("old", "ended"):
        check_hidden(lab, job, "ann")
        assert store.job(job) is not None
    assert "only an admin may cancel it" in said(lab.ask("ann", messages.Cancel(job="open")))
    events = lab.ask("ann", messages.GetEvents())
    assert isinstance(events, EventList)
    assert "old" not in {event.job for event in events.events}
    admins = lab.ask("eve", messages.ListJobs())
    assert isinstance(admins, JobList)
    assert {job.job for job in admins.jobs} == {"old", "open", "ended"}
    assert isinstance(lab.ask("eve", messages.Delete(job="ended")), Deleted)
    assert store.job("ended") is None


def test_a_revoked_certificate_is_told_so(lab: Lab) -> None:
    hello = Hello(role="worker", name="mal-0", instance="i", protocol=1, version="", engine=1)
    assert "'mal' is revoked" in (lab.authorization.refuse_role(hello) or "")
    assert "'mal' is revoked" in said(lab.ask("mal", messages.ListJobs()))
    assert lab.authorization.refuse_worker("lab1-0") is None
    lab.authorization.role_bindings = RoleBindings({"lab1": "revoked", "ann": "submitter"})
    assert "'lab1' is revoked" in (lab.authorization.refuse_worker("lab1-0") or "")
    assert "no longer lists 'lab2-0'" in (lab.authorization.refuse_worker("lab2-0") or "")


# ------------------------------------------------------------------------------------- pause, priority, retry


def test_a_failed_job_is_tried_again_under_another_id(lab: Lab) -> None:
    lab.submit("ann", "mine", config=JobConfig(seed=7), priority=3)
    assert "has not failed" in said(lab.ask("ann", messages.Retry(job="mine", again="second")))
    lab.fail("mine")
    for _ in range(2):  # the answer may be lost
        again = view(lab.ask("ann", messages.Retry(job="mine", again="second")))
        assert (again.job, again.seed, again.priority, again.submitter) == ("second", 7, 3, "ann")
    assert view(lab.ask("ann", messages.Status(job="mine"))).state == "failed"


def test_a_job_is_not_tried_again_under_the_id_of_anothers(lab: Lab) -> None:
    lab.submit("ann", "mine", b"the same")
    lab.submit("bob", "his", b"the same")
    lab.fail("his")
    assert "is taken" in said(lab.ask("bob", messages.Retry(job="his", again="mine")))


def test_what_was_answered_holds_after_a_restart(lab: Lab) -> None:
    """Each change by itself: the coordinator ends right after its answer."""
    for job in ("cancelled", "deleted", "paused", "urgent", "shown", "failed"):
        lab.submit("ann", job)
    lab.fail("deleted")
    lab.fail("failed")
    for body in (
        messages.Cancel(job="cancelled"), messages.Delete(job="deleted"), messages.Pause(job="paused"),
        messages.SetPriority(job="urgent", priority=5), messages.Share(job="shown"),
        messages.Retry(job="failed", again="again"), messages.Submit(
            job="new", name="n", config=JobConfig(), table=hashlib.sha256(b"t,x\n").hexdigest()
        ),
    ):  # fmt: skip
        assert not isinstance(lab.ask("ann", body), Failure), body
        lab = Lab(lab.store)

    def status(job: str) -> messages.JobView:
        return view(lab.ask("ann", messages.Status(job=job)))

    assert (status("cancelled").state, status("paused").paused, status("urgent").priority) == ("cancelled", True, 5)
    assert (status("shown").shared, status("again").submitter, status("new").submitter) == (True, "ann", "ann")
    assert said(lab.ask("ann", messages.Status(job="deleted"))).startswith("there is no job deleted")
    lab.ask("eve", messages.SetQueue(paused=True))
    assert Lab(lab.store).controller.queue.is_paused


# ------------------------------------------------------------------------------------------------- limits


def limit(lab: Lab, **limits: object) -> None:
    lab.controller.queue.limits = Limits.model_validate(limits)


def test_jobs_beyond_those_that_may_wait_are_refused(lab: Lab) -> None:
    limit(lab, user=Allowance(queued=2, running=1), total=Total(queued=3))
    for number in range(3):
        lab.submit("ann", f"a{number}")
    assert "2 jobs of ann wait, and limits allow 2" in said(lab.submit("ann", "a3"))
    assert view(lab.submit("ann", "a2")).state == "queued"  # it is known already
    lab.submit("bob", "b0")
    lab.submit("bob", "b1")
    assert "3 jobs wait, and limits allow 3" in said(lab.submit("bob", "b2"))


def test_bytes_of_a_user_hold_to_the_byte(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(admission, "RESULT_RESERVE", 10)
    limit(lab, user=Allowance(stored=100))
    table = bytes(range(40))
    view(lab.submit("ann", "a", table))  # 40 + 10
    view(lab.submit("ann", "b", table))  # the same table: 40 + 20
    assert lab.store.held("ann").stored == 40
    assert "stores 40 bytes" in said(lab.submit("ann", "c", bytes(31)))
    view(lab.submit("ann", "c", bytes(30)))  # 70 + 30
    assert lab.store.held("ann").stored == 70
    assert "exceed the 100" in said(lab.submit("ann", "d", table))
    view(lab.submit("bob", "z", bytes(90)))


def test_tables_that_no_deletion_makes_room_for_are_refused_from_who_holds_most(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("atoll_coordinator.service.store.retention.LEAST_LIVE", 100)
    full = Lab(lab.store, retention=Retention(size_bytes=100))
    for number in range(3):
        full.submit("ann", f"a{number}", str(number).encode() * 30)
    sentence = said(full.submit("ann", "more", b"m" * 30))
    assert "take 90 bytes (90 of them belong to ann); 30 more exceed the 100 that" in sentence
    assert "submit again when one has ended" in sentence
    assert isinstance(full.submit("ann", "again", b"0" * 30), JobStatus), "a table that is there takes no more room"
    assert isinstance(full.submit("bob", "b", b"b" * 30), JobStatus), "his share is free, whatever others hold"
    assert isinstance(full.submit("eve", "c", b"c" * 60), Failure)
    for job in ("a0", "again"):
        full.fail(job)
    full.fail("a1")
    assert isinstance(full.submit("ann", "more", b"m" * 30), JobStatus)


def test_time_is_given_and_bounded_and_a_job_known_already_keeps_what_it_has(lab: Lab) -> None:
    limit(lab, time=Times(default=60.0, most=100.0))
    asked = JobConfig(budget=BudgetConfig(max_time=101.0))
    assert "asks for 101 s" in said(lab.submit("ann", "a", config=asked))
    lab.submit("ann", "a")
    assert lab.controller.jobs["a"].config.budget.max_time == 60.0
    limit(lab)
    assert view(lab.submit("ann", "a")).job == "a"
    assert "other contents" in said(lab.submit("ann", "a", config=JobConfig(budget=BudgetConfig(max_time=61.0))))


# ---------------------------------------------------------------------------------------------- followers


def test_who_follows_all_that_happens_hears_of_what_may_be_seen(lab: Lab) -> None:
    for user in ("ann", "bob", "eve"):
        assert isinstance(lab.follow(user), Following)
    lab.submit("ann", "a")
    lab.submit("bob", "b", shared=True)
    assert lab.heard() == {("ann-1", "a"), ("ann-1", "b"), ("bob-1", "b"), ("eve-1", "a"), ("eve-1", "b")}


def test_followers_hear_no_more_of_a_job_that_becomes_private_or_once_they_are_revoked(lab: Lab) -> None:
    lab.submit("ann", "a", shared=True)
    for user in ("ann", "bob", "eve"):
        lab.follow(user, "a")
    lab.ask("ann", messages.Share(job="a", shared=False))
    assert {client for client, _ in lab.heard()} == {"ann-1", "eve-1"}
    lab.authorization.role_bindings = RoleBindings({"ann": "submitter", "eve": "revoked"})
    lab.clients.check_followers()
    lab.controller.cancel("a", NOW)
    assert {client for client, _ in lab.heard()} == {"ann-1"}


def test_lines_of_workers_are_shown_to_those_who_see_their_jobs(lab: Lab) -> None:
    lab.submit("ann", "a")
    lab.submit("bob", "b")
    for job in ("a", "b", None):
        lab.controller.events.add_line(job, {"text": f"of {job}", "level": "warning"})

    def lines(user: str) -> list[str]:
        answer = lab.ask(user, messages.GetEvents(of_workers=True))
        assert isinstance(answer, messages.EventList)
        return [event.text for event in answer.events]

    assert (lines("ann"), lines("bob"), lines("eve")) == (["of a"], ["of b"], ["of a", "of b", "of None"])
    assert isinstance(lab.ask("bob", messages.GetEvents(job="a", of_workers=True)), Failure)


def test_a_job_that_has_ended_is_shown_as_shared_or_private_as_it_is_now(lab: Lab) -> None:
    lab.submit("ann", "a")
    lab.controller.cancel("a", NOW)
    assert not view(lab.ask("ann", messages.Status(job="a"))).shared
    assert view(lab.ask("ann", messages.Share(job="a"))).shared
    assert (lab.seen("bob"), view(lab.ask("bob", messages.Status(job="a"))).state) == (["a"], "cancelled")
