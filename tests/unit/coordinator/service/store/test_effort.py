"""What the loop asks of the store takes as long with ten thousand stored jobs as with a hundred: steps are counted.

A step is one of SQLite's virtual machine; a row that is read and not answered costs several.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import count
from random import Random

import pytest

from atoll_coordinator.service.store.events import EventRecord
from atoll_coordinator.service.store.holdings import ALL, Held
from atoll_coordinator.service.store.jobs import MAX_COUNTED, JobRecord, Viewer
from atoll_coordinator.service.store.store import Store
from tests.blobs import put_blob

ANN = Viewer("ann")
FEW, MANY = 100, 5_000


def filled(number: int) -> Store:
    """Return a store with so many ended jobs of bob, and of ann ten of each kind among the oldest and the newest."""
    store, names = Store.open(None, count().__next__), count()
    for owner, jobs, states in (
        ("ann", 10, ("done", "queued")), ("bob", number, ("done",)), ("ann", 10, ("running", "failed")),
    ):  # fmt: skip
        for index in range(jobs):
            name, state = f"{next(names):06}", states[index % len(states)]
            table = put_blob(store, f"table {index % 7} of {owner}".encode())
            store.add_job(JobRecord(name, name, "{}", table, "2026", submitter=owner, shared=int(index == 4)))
            store.add_events([EventRecord(name, "t", "submitted", "{}")])
            if state in ("done", "failed"):
                store.commit_result(name, state, "{}", view="{}")
            elif state != "queued":
                store.update_job(name, state=state)
    return store


@pytest.fixture(scope="module")
def stores() -> Iterator[tuple[Store, Store]]:
    few, many = filled(FEW), filled(MANY)
    with few, many:
        yield few, many


def steps(store: Store, ask: Callable[[Store], object]) -> int:
    """Return how many steps of SQLite's machine a question takes."""
    taken = [0]

    def step() -> None:
        taken[0] += 1

    store._connection.set_progress_handler(step, 1)
    try:
        ask(store)
    finally:
        store._connection.set_progress_handler(None, 1)
    return taken[0]


QUESTIONS: dict[str, Callable[[Store], object]] = {
    "all": lambda store: store.job_page(limit=5),
    "open": lambda store: store.job_page(is_open=True, limit=5),
    "older": lambda store: store.job_page(before=50, limit=5),
    **{
        f"{whose} {state}": lambda store, state=state, viewer=viewer: store.job_page(  # type: ignore[misc]
            state=state, limit=5, viewer=viewer
        )
        for whose, viewer in (("all", None), ("own", ANN), ("nobody's", Viewer("eve")))
        for state in ("queued", "preparing", "running", "refining", "done", "failed", "cancelled")
    },
    "own": lambda store: store.job_page(limit=50, viewer=ANN),
    "own open": lambda store: store.job_page(is_open=True, limit=5, viewer=ANN),
    "own older": lambda store: store.job_page(before=15, limit=5, viewer=ANN),
    "one by its beginning": lambda store: store.count_jobs("00000"),
    "own by their beginning": lambda store: store.count_jobs("0", ANN),
    "events": lambda store: store.events(None, 0, 20),
    "own events": lambda store: store.events(None, 0, 20, ANN),
    "events of a job": lambda store: store.events("000015", 0, 20, Viewer("bob")),
    "own events after": lambda store: store.events(None, 1, 20, ANN),
    "lines of logs": lambda store: store.events(None, 0, 20, of_workers=True),
    "own lines of logs": lambda store: store.events(None, 0, 20, ANN, of_workers=True),
    "bytes of a user": lambda store: store.held("bob").stored,
    "bytes of all": lambda store: store.held(ALL).stored,
    "bytes of blobs": lambda store: store.blob_bytes(),
    "users": lambda store: store.count_holders(),
    "the oldest": lambda store: store.oldest_ended_job(),
    "the oldest of a user": lambda store: store.oldest_ended_job(ANN),
    "the first to go": lambda store: store.first_to_delete(),
    "those that go on": lambda store: store.open_jobs(),
    "a table": lambda store: store.uses_table("x" * 64, ANN),
    "unused": lambda store: store.unused_blobs(),
    "one job": lambda store: (store.job("000001"), store.is_seen("000001", ANN), store.result("000001")),
}


@pytest.mark.parametrize("question", QUESTIONS)
def test_no_question_takes_longer_with_all_that_is_stored(stores: tuple[Store, Store], question: str) -> None:
    few, many = (steps(store, QUESTIONS[question]) for store in stores)
    assert many <= few + 40, question


def test_a_change_takes_no_longer_with_all_that_is_stored(stores: tuple[Store, Store]) -> None:
    table = b"a new table"

    def change(store: Store) -> None:
        store.add_job(JobRecord("new", "n", "{}", put_blob(store, table), "2026", submitter="ann"))
        store.keep_prepared("new", b"dataset", b"prepared")
        store.share_job("new", True)
        store.commit_result("new", "done", "{}")
        store.delete_job("new")
        store.delete_unused_blobs(store.unused_blobs())
        store.keep_served()

    few, many = (steps(store, change) for store in stores)
    assert many <= 1.1 * few + 100


def test_pages_are_in_order_and_have_each_job_once(stores: tuple[Store, Store]) -> None:
    for viewer in (None, ANN):
        seen: list[int] = []
        before: int | None = None
        while page := stores[0].job_page(limit=7, before=before, viewer=viewer):
            seen += [number for number, _ in page]
            before = seen[-1]
        assert seen == sorted(set(seen), reverse=True)
        assert len(seen) == (FEW + 20 if viewer is None else 21), "bob shares one"
    assert stores[1].count_jobs("0") == MAX_COUNTED
    assert stores[0].job_page(is_open=True, state="done", limit=5) == ()


def test_what_is_added_up_is_what_is_there(stores: tuple[Store, Store]) -> None:
    check_sums(stores[0])


def check_sums(store: Store, owners: Sequence[str] = ("ann", "bob")) -> None:
    """Compare what is kept of sums with what SQLite adds up."""

    def added_up(query: str, *values: str) -> int:
        (total,) = store._connection.execute(query, values).fetchone()
        return int(total or 0)

    used = (
        "SELECT sum(size) FROM blobs WHERE digest IN (SELECT {} FROM jobs WHERE {}) "
        "AND digest NOT IN (SELECT {} FROM jobs WHERE {})"
    )
    results = "SELECT sum(result_bytes) FROM jobs WHERE {}"
    live, ended = (f"state {word} ('done', 'failed', 'cancelled')" for word in ("NOT IN", "IN"))
    for owner in owners:
        mine = f"submitter = '{owner}'"
        assert store.held(owner).stored == added_up(used.format("table_digest", mine, "1", "FALSE")) + added_up(
            results.format(mine)
        )
        freeable = sum(
            added_up(used.format(digest, f"{mine} AND {ended}", f"coalesce({digest}, '')", live))
            for digest in ("table_digest", "dataset_digest", "prepared_digest")
        )
        assert store.held(owner).freeable == freeable + added_up(results.format(mine))
    held, digests = store.held(ALL), ("table_digest", "dataset_digest", "prepared_digest")
    assert store.blob_bytes() == added_up("SELECT sum(size) FROM blobs")
    assert held.live == sum(added_up(used.format(digest, live, "1", "FALSE")) for digest in digests)
    free = sum(added_up(used.format(digest, ended, f"coalesce({digest}, '')", live)) for digest in digests)
    assert held.freeable == free + added_up(results.format("TRUE"))


@pytest.mark.parametrize("seed", range(4))
def test_sums_hold_whatever_becomes_of_jobs(seed: int) -> None:
    """Jobs share tables and datasets, begin their search twice, end with and without results, and are deleted."""
    random, names = Random(seed), count()
    with Store.open(None) as store:
        live: list[str] = []
        ended: list[str] = []
        for _ in range(150):
            match random.choice(("add", "search", "end", "delete")):
                case "add":
                    table = put_blob(store, b"t" * random.randrange(1, 6))
                    owner = random.choice((None, "ann", "bob"))
                    live.append(f"j{next(names)}")
                    store.add_job(JobRecord(live[-1], "n", "{}", table, "2026", submitter=owner))
                case "search" if live:
                    data = (bytes([random.randrange(3)]) * random.randrange(10, 14) for _ in range(2))
                    store.keep_prepared(random.choice(live), next(data), b"p" + next(data))
                case "end" if live:
                    ended.append(live.pop(random.randrange(len(live))))
                    result = random.choice((None, "{}", "{...}"))
                    store.commit_result(ended[-1], random.choice(("done", "failed")), result)
                    store.commit_result(ended[-1], "done", "again")
                case "delete" if ended:
                    store.delete_job(ended.pop(random.randrange(len(ended))))
            store.delete_unused_blobs(store.unused_blobs())
            check_sums(store)
        for job in live:
            store.commit_result(job, "done", "{}")
        for job in (*live, *ended):
            store.delete_job(job)
        assert (store.held(ALL), store.blob_bytes(), store.count_holders()) == (Held(), 0, 0)
