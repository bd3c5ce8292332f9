"""Ended jobs are deleted when a client asks for it, or when the retention no longer keeps them."""

from collections.abc import Iterator

import pytest

from atoll_coordinator.service.job_controller import JobController
from atoll_coordinator.service.requests.deletion import CHECK_INTERVAL_S, JobDeletion
from atoll_coordinator.service.store.holdings import ALL
from atoll_coordinator.service.store.jobs import JobRecord
from atoll_coordinator.service.store.retention import Retention
from atoll_coordinator.service.store.store import Store
from atoll_core.config import JobConfig
from atoll_core.errors import RefusedError
from atoll_core.wire.messages.clients import Submit
from tests.blobs import put_blob
from tests.unit.coordinator.service.requests.test_clients import Tasks, controller_of

DAY = 86400.0


class Now:
    """Seconds for which the store has been served."""

    s = 0.0


@pytest.fixture
def store() -> Iterator[Store]:
    Now.s = 0.0
    with Store.open(None, lambda: Now.s) as opened:
        yield opened


def add(store: Store, name: str, finished: str | None, submitter: str = "ann") -> None:
    """Add a job, which has ended on a day of January 2026 if that is given; the store is served from the first."""
    table = put_blob(store, name.encode() * 100_000)
    spec, submitted = JobConfig().model_dump_json(), "2026-01-01T00:00:00+00:00"
    store.add_job(JobRecord(name, name, spec, table, submitted, submitter=submitter))
    if finished is not None:
        Now.s = int(finished) * DAY
        store.commit_result(name, "done", "{}", finished=f"2026-01-{finished}T00:00:00.000+00:00")


def deletion(store: Store, retention: Retention = Retention()) -> tuple[JobDeletion, JobController]:  # noqa: B008
    controller = controller_of(store, Tasks(), "2026-01-31T00:00:00.000+00:00")
    controller.recover(0.0)
    return JobDeletion(controller, store, retention), controller


def deleted_in_turn(store: Store, retention: Retention) -> list[str]:
    """Return which jobs are deleted, in order."""
    deletes, _ = deletion(store, retention)
    Now.s = 31 * DAY
    names: list[str] = []
    while True:
        before = {job.id for job in store.jobs()}
        deletes.delete_expired(0.0)
        gone = before - {job.id for job in store.jobs()}
        if not gone:
            return names
        names += gone


def test_an_ended_job_is_deleted_and_its_end_is_noted(store: Store) -> None:
    add(store, "a", "10")
    deletes, controller = deletion(store)
    deletes.delete("a", "a client asked for it")
    assert (store.jobs(), controller.shown.view("a", 0.0), controller.shown.result("a")) == ((), None, None)
    (event,) = controller.events.read(None, 0, 9)
    assert (event.event, event.job, event.text) == ("deleted", None, "job a is deleted: a client asked for it")
    deletes.delete("a", "the answer was lost, and it is asked for again")


def test_the_id_of_a_deleted_job_is_not_given_again(store: Store) -> None:
    """A worker that missed the end of the deleted job would compute the new one on the old data."""
    add(store, "a", "10")
    deletes, controller = deletion(store)
    deletes.delete("a", "a client asked for it")
    again = Submit(job="a", name="a", config=JobConfig(), table=put_blob(store, b"table"))
    with pytest.raises(RefusedError, match="job a was deleted, and its id is not used again; submit under another"):
        controller.submit(again, 1.0)
    controller.submit(again.model_copy(update={"job": "b"}), 2.0)
    assert list(controller.jobs) == ["b"]


def test_jobs_beyond_an_age_are_deleted_oldest_first(store: Store) -> None:
    for name, finished in (("late", "30"), ("old", "10"), ("oldest", "09"), ("live", None)):
        add(store, name, finished)
    assert deleted_in_turn(store, Retention(age_s=2 * DAY)) == ["oldest", "old"]


def test_tables_that_wait_delete_nobodys_results(store: Store) -> None:
    """No deletion could bring their size down: all that has ended would go, and the store be as full as before."""
    add(store, "mine", "10")
    most = store.held(ALL).freeable + 110_000
    for number in range(5):
        add(store, f"his-{number}", None, "bob")
    assert deleted_in_turn(store, Retention(size_bytes=most)) == []
    assert store.held(ALL).live > most
    store.commit_result("his-0", "cancelled", None)
    assert deleted_in_turn(store, Retention(size_bytes=most)) != []


def test_the_user_who_holds_most_loses_first(store: Store) -> None:
    for name, finished in (("mine", "02"), ("mine-too", "03")):
        add(store, name, finished)
    most = store.held(ALL).freeable + 110_000
    for number, finished in enumerate(("10", "11", "12", "13")):
        add(store, f"his-{number}", finished, "bob")
    deleted = deleted_in_turn(store, Retention(size_bytes=most))
    assert deleted == ["his-0", "his-1", "mine", "his-2"], "whoever holds most at the time, the oldest first"
    assert store.job("mine-too") is not None
    assert store.job("his-3") is not None


def test_tables_that_jobs_of_others_need_count_for_nobody(store: Store) -> None:
    """Deleting all of one user's results would free nothing of a table that another user's job waits with."""
    table = put_blob(store, bytes(3_000_000))
    for name, owner in (("mine", "ann"), ("waits", "bob")):
        store.add_job(JobRecord(name, name, "{}", table, "2026", submitter=owner))
    store.commit_result("mine", "done", "{}")
    for number, finished in enumerate(("10", "11")):
        add(store, f"his-{number}", finished, "bob")
    assert store.held("ann").freeable == len("{}")
    assert deleted_in_turn(store, Retention(size_bytes=700_000)) == ["his-0"]
    store.commit_result("waits", "cancelled", None)
    assert store.held("ann").freeable == 3_000_000 + len("{}")
    assert store.held("bob").freeable == 3_000_000 + 500_000 + len("{}")


def test_a_clock_that_is_set_to_another_year_deletes_nothing(store: Store) -> None:
    """Neither while the coordinator runs, nor at the next start; what is left of the age is what it served."""
    add(store, "mine", "01")
    controller = controller_of(store, Tasks(), "2099-01-01T00:00:00.000+00:00")
    controller.recover(0.0)
    JobDeletion(controller, store, Retention(age_s=2 * DAY)).delete_expired(0.0)
    assert store.job("mine") is not None
    Now.s += 2 * DAY + 1.0
    JobDeletion(controller, store, Retention(age_s=2 * DAY)).delete_expired(0.0)
    assert store.job("mine") is None


def test_the_store_is_asked_now_and_then(store: Store) -> None:
    add(store, "young", "30")
    deletes, _ = deletion(store, Retention(age_s=2 * DAY))
    deletes.delete_expired(0.0)
    add(store, "old", "01")
    Now.s = 31 * DAY
    deletes.delete_expired(CHECK_INTERVAL_S - 1.0)
    assert store.job("old") is not None
    deletes.delete_expired(CHECK_INTERVAL_S)
    assert store.job("old") is None
