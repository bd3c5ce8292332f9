"""The store keeps what it was given, once, through its own end; and says what is wrong with a file."""

import contextlib
import errno
import fcntl
import hashlib
import itertools
import os
import sqlite3
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from atoll_coordinator.service.store.checkpoints import MAX_FAILED, Death
from atoll_coordinator.service.store.events import LEAST_COMMITS, MAX_EVENTS, EventRecord
from atoll_coordinator.service.store.jobs import JobRecord
from atoll_coordinator.service.store.lock import Lock, last_beat
from atoll_coordinator.service.store.schema import FILE_NAME, SCHEMA_VERSION
from atoll_coordinator.service.store.store import Store
from atoll_core.errors import LocalProtocolError, StoreError
from atoll_core.wire.messages.limits import CHUNK_SIZE
from atoll_core.wire.state_pieces import IslandState
from tests.blobs import put_blob
from tests.placements import placements_in

JOB = JobRecord("j1", "lynx θ", '{"seed": 0}', "ab" * 32, "2026-01-01T00:00:00Z")


@pytest.fixture(params=["memory", "disk"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Store]:
    with Store.open(None if request.param == "memory" else tmp_path / "state") as opened:
        yield opened


def begin_term(store: Store, job: str, variable: str) -> int:
    """Begin a term of one archipelago; return its number."""
    terms: list[int] = []
    store.begin_terms([(job, variable)], lambda index, term: (terms.append(term), b"placement")[1])
    return terms[0]


def test_a_job_is_kept_as_it_was_given_and_changed_as_told(store: Store) -> None:
    assert store.add_job(JOB)
    assert store.job("j1") == JOB
    store.keep_prepared("j1", b"dataset", b"prepared")
    store.update_job("j1", state="running")
    store.update_job("j1", state="refining", elapsed=1.5)
    changed = store.job("j1")
    assert changed is not None
    assert (changed.state, changed.elapsed, changed.name) == ("refining", 1.5, "lynx θ")
    assert (store.get_blob(changed.dataset_digest or ""), store.get_blob(changed.prepared_digest or "")) == (
        b"dataset", b"prepared",
    )  # fmt: skip
    with pytest.raises(LocalProtocolError, match="cannot be changed"):
        store.update_job("j1", dataset_digest="cd")


def test_the_first_end_of_a_job_wins(store: Store) -> None:
    store.add_job(JOB)
    assert store.result("j1") is None
    assert store.commit_result("j1", "done", '{"schema": 1}', finished="2026-01-02")
    assert not store.commit_result("j1", "cancelled", None, "by hand")
    job = store.job("j1")
    assert job is not None
    assert (job.state, job.reason, job.finished, store.result("j1")) == ("done", None, "2026-01-02", '{"schema": 1}')


def test_a_damaged_blob_is_forgotten_and_can_be_put_again(store: Store) -> None:
    data, digest = _upload(CHUNK_SIZE + 1)
    for _ in range(2):
        assert put_blob(store, data) == digest
        assert store.get_blob(digest) == data
        store._connection.execute("UPDATE chunks SET data = x'08' WHERE digest = ? AND number = 1", (digest,))
        with pytest.raises(KeyError):
            store.get_blob(digest)
        assert not store.has_blob(digest)


def _upload(size: int) -> tuple[bytes, str]:
    data = b"\x07" * size
    return data, hashlib.sha256(data).hexdigest()


def test_chunks_of_an_upload_are_kept_in_their_order(store: Store) -> None:
    data, digest = _upload(2 * CHUNK_SIZE + 5)
    chunks = [data[:CHUNK_SIZE], data[CHUNK_SIZE : 2 * CHUNK_SIZE], data[2 * CHUNK_SIZE :]]
    assert store.put_chunk("hers", 0, chunks[0])
    assert not store.put_chunk("hers", 2, chunks[2], digest)
    assert store.put_chunk("hers", 1, chunks[1])
    assert (store.has_blob(digest), store.blob_bytes()) == (False, 2 * CHUNK_SIZE)
    assert store.put_chunk("hers", 2, chunks[2], digest)
    assert store.get_blob(digest) == data
    assert (store.unused_blobs(), store.blob_bytes()) == ((digest,), len(data))


@pytest.mark.parametrize("is_first", [True, False])
def test_two_uploads_of_one_blob_are_kept_once(store: Store, is_first: bool) -> None:
    data, digest = _upload(CHUNK_SIZE + 1)
    names = (digest, "another") if is_first else ("another", digest)
    for name in names:
        assert store.put_chunk(name, 0, data[:CHUNK_SIZE])
    assert store.put_chunk(names[0], 1, data[CHUNK_SIZE:], digest)
    assert store.put_chunk(names[1], 1, data[CHUNK_SIZE:], digest)
    assert store.get_blob(digest) == data
    assert (store.unused_blobs(), store.blob_bytes()) == ((digest,), len(data))


def test_threads_may_share_a_store(store: Store) -> None:
    store.add_job(JOB)
    terms: list[int] = []
    threads = [threading.Thread(target=lambda: terms.append(begin_term(store, "j1", "x"))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(terms) == list(range(1, 9))


def _spoil(directory: Path, how: str) -> None:
    with Store.open(directory) as store:
        put_blob(store, bytes(100_000))
    file = directory / FILE_NAME
    if how == "text":
        file.write_text("this is no database at all, however long one may look at it. " * 100)
    elif how == "truncated":
        file.write_bytes(file.read_bytes()[:20_000])
    elif how == "scribbled":
        data = bytearray(file.read_bytes())
        data[4096:8192] = b"\xff" * 4096
        file.write_bytes(data)
    else:
        statements = {
            "foreign": "PRAGMA application_id = 7",
            "newer": f"PRAGMA user_version = {SCHEMA_VERSION + 1}",
            "nameless": "DELETE FROM realm",
        }
        with contextlib.closing(sqlite3.connect(file)) as connection:
            connection.execute(statements[how])
            connection.commit()


@pytest.mark.parametrize(
    ("how", "reason"),
    [
        ("text", "not a database.*restore it from a copy"),
        ("truncated", "restore it from a copy"),
        ("scribbled", "restore it from a copy"),
        ("foreign", "not a store of Atoll"),
        ("newer", "written by a newer version"),
        ("nameless", "has no name.*restore it from a copy"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_in_one_sentence_and_left_alone(
    tmp_path: Path, how: str, reason: str
) -> None:
    _spoil(tmp_path, how)
    before = (tmp_path / FILE_NAME).read_bytes()
    with pytest.raises(StoreError, match=reason) as caught:
        Store.open(tmp_path)
    assert "\n" not in str(caught.value)
    assert (tmp_path / FILE_NAME).read_bytes() == before


@pytest.mark.parametrize("umask", [0o000, 0o022])
def test_nobody_else_may_lock_a_store_or_look_into_its_folder(tmp_path: Path, umask: int) -> None:
    """A lock is taken by whoever may open its file, if only to read it."""
    former = os.umask(umask)
    try:
        state = tmp_path / "of" / "atoll" / "state"
        with Store.open(state) as store:
            beat = last_beat(state)
            assert beat is not None
            Lock.seize(state, beat)
            put_blob(store, b"measured")
            modes = {path.name: path.stat().st_mode & 0o777 for path in state.iterdir()}
    finally:
        os.umask(former)
    assert state.stat().st_mode & 0o777 == 0o700
    assert [folder.stat().st_mode & 0o022 for folder in (state.parent, state.parent.parent)] == [0, 0]
    assert {FILE_NAME, f"{FILE_NAME}-wal", "lock", "guard"} <= modes.keys()
    assert set(modes.values()) == {0o600}


@pytest.fixture
def former(tmp_path: Path) -> Path:
    """A store as an earlier version made it: open to all users of the machine."""
    state = tmp_path / "former"
    Store.open(state).close()
    (state / "lock").write_text("999999999 beats\n")
    for name in ("lock", "takeover", "replaced-1.sqlite3", *(f"{FILE_NAME}{end}" for end in ("-shm", "-journal", ""))):
        (state / name).touch()
        (state / name).chmod(0o644)
    (state / "guard").unlink(missing_ok=True)
    state.chmod(0o755)
    return state


def modes_in(state: Path) -> set[int]:
    return {path.stat().st_mode & 0o777 for path in state.iterdir()}


def test_a_store_of_an_earlier_version_is_closed_to_others_and_that_is_said_once(
    former: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for _ in range(2):
        with Store.open(former) as store:
            put_blob(store, b"measured")
            assert modes_in(former) == {0o600}
            assert former.stat().st_mode & 0o777 == 0o700
    (said,) = (record for record in caplog.records if "access has been removed" in record.message)
    assert "its folder, " in str(said.__dict__)
    assert "lock" in str(said.__dict__)


def test_a_folder_with_other_files_stays_open_and_the_store_is_closed(former: Path) -> None:
    (former / "notes.txt").touch(mode=0o644)
    Store.open(former).close()
    assert former.stat().st_mode & 0o777 == 0o755
    assert modes_in(former) == {0o600, 0o644}
    assert (former / "notes.txt").stat().st_mode & 0o777 == 0o644


def locked(path: Path) -> int:
    """Lock a file as any user can who may read it."""
    held = os.open(path, os.O_RDONLY)
    fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return held


@pytest.mark.parametrize("contents", ["999999999 beats\n", "28154\n", "", "1 beats\n", "no number"])
def test_who_holds_a_lock_that_others_could_open_keeps_no_coordinator_out(
    former: Path, monkeypatch: pytest.MonkeyPatch, contents: str
) -> None:
    """Whoever opened it while it was open may hold it for ever, and the process that it names does not exist."""
    monkeypatch.setattr("atoll_coordinator.service.store.lock._SIGN_OF_LIFE_S", 0.0)
    (former / "lock").write_text(contents)
    held = [locked(former / "lock"), locked(former / "takeover")]
    try:
        with Store.open(former):
            beat = last_beat(former)
            assert beat is not None
            with pytest.raises(StoreError, match=f"in use by another coordinator .process {os.getpid()}"):
                Store.open(former)
            seized = Lock.seize(former, beat)
            assert seized is not None, "nor one on standby"
            seized.release()
    finally:
        for file in held:
            os.close(file)


def test_a_coordinator_of_an_earlier_version_keeps_its_store(former: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its lock is open to others as well: it is told from them by its process or, elsewhere, by its beats."""
    held = os.open(former / "lock", os.O_RDWR)
    fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    beats = itertools.count(10**9)
    monkeypatch.setattr("time.sleep", lambda _: os.utime(held, ns=(0, next(beats))))
    try:
        with pytest.raises(StoreError, match="in use by another coordinator; stop"):
            Store.open(former)
        os.pwrite(held, f"{os.getpid()} beats \n".encode(), 0)
        monkeypatch.setattr("time.sleep", lambda _: None)
        with pytest.raises(StoreError, match=f"in use by another coordinator .process {os.getpid()}"):
            Store.open(former)
    finally:
        os.close(held)
    Store.open(former).close()
    assert modes_in(former) == {0o600}


def test_of_several_that_replace_a_lock_at_once_one_has_it(former: Path) -> None:
    """Whoever has opened the file that is replaced finds that out, and tries the new one."""
    locks: list[Lock] = []
    refused: list[StoreError] = []
    together = threading.Barrier(6)

    def take() -> None:
        together.wait(30)
        try:
            locks.append(Lock(former))
        except StoreError as error:
            refused.append(error)

    threads = [threading.Thread(target=take) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    assert (len(locks), len(refused)) == (1, 5)
    locks[0].release()


@pytest.mark.parametrize(("code", "exit_code"), [(errno.EROFS, 1), (errno.ENOSPC, 1), (errno.EACCES, 2)])
def test_a_folder_that_cannot_be_written_for_now_is_no_mistake_in_an_option(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, exit_code: int
) -> None:
    def refuse(*_: object, **__: object) -> int:
        raise OSError(code, os.strerror(code))

    with monkeypatch.context() as refusing:
        refusing.setattr("atoll_coordinator.service.store.lock.os.open", refuse)
        with pytest.raises(StoreError, match="cannot be written") as caught:
            Store.open(tmp_path)
    assert caught.value.exit_code == exit_code


def test_a_disk_that_is_full_at_the_start_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def is_full(*_: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as full:
        full.setattr("atoll_coordinator.service.store.lock.os.pwrite", is_full)
        with pytest.raises(StoreError, match="no space left on device; check that there is room"):
            Store.open(tmp_path)
    Store.open(tmp_path).close()


def test_events_come_in_order_from_where_one_left_off_and_the_oldest_are_forgotten(store: Store) -> None:
    store.add_events(EventRecord(job, "t", "k", str(n)) for n in range(3) for job in ("a", "b", None))
    assert [event.contents for event in store.events("a", 0, 2)] == ["1", "2"]
    assert [event.job for event in store.events(None, 0, 4)] == [None, "a", "b", None]
    (first, *_) = store.events("b", 0, 9)
    assert [event.contents for event in store.events("b", first.number, 1)] == ["1"]
    store.add_events(EventRecord("a", "t", "k", str(n)) for n in range(3, MAX_EVENTS + 2))
    kept = store.events("a", 0, 2 * MAX_EVENTS)
    assert (len(kept), kept[0].contents, kept[-1].contents) == (MAX_EVENTS, "2", str(MAX_EVENTS + 1))
    assert len(store.events("b", 0, 9)) == 3


def test_commits_are_forgotten_before_what_is_rarer(store: Store) -> None:
    def add(kind: str, numbers: range) -> None:
        store.add_events(EventRecord("a", "t", kind, str(number)) for number in numbers)

    def kept(kind: str) -> list[int]:
        return [int(event.contents) for event in store.events("a", 0, 2 * MAX_EVENTS) if event.kind == kind]

    add("isolated", range(10))
    add("commit", range(2 * MAX_EVENTS))
    assert kept("isolated") == list(range(10))
    assert kept("commit") == list(range(MAX_EVENTS + 10, 2 * MAX_EVENTS))
    add("stalled", range(MAX_EVENTS))
    assert kept("commit") == list(range(2 * MAX_EVENTS - LEAST_COMMITS, 2 * MAX_EVENTS))
    assert kept("isolated") == []
    assert kept("stalled") == list(range(LEAST_COMMITS, MAX_EVENTS))


# ------------------------------------------------------------------------------------------ checkpoints


def states_of(epoch: int) -> dict[int, IslandState]:
    return {island: IslandState.of(f"{epoch}/{island}".encode()) for island in range(3)}


def checkpoint(store: Store, epoch: int) -> bool:
    return store.commit_checkpoint("j1", "x", epoch, b"progress", states_of(epoch), 1.0)


def test_of_the_last_jobs_that_failed_so_the_last_checkpoints_are_kept(store: Store) -> None:
    for number in range(MAX_FAILED + 2):
        store.add_job(JobRecord(f"j{number}", "", "{}", "", ""))
        for epoch in (8, 16):
            for variable in ("x", "y"):
                store.commit_checkpoint(f"j{number}", variable, epoch, b"progress", states_of(epoch), 1.0)
        assert store.commit_result(f"j{number}", "failed", None, "it dies", "now", keeps_checkpoints=True)
    kept = [number for number in range(MAX_FAILED + 2) if store.checkpoints(f"j{number}")]
    assert kept == list(range(2, MAX_FAILED + 2))
    assert store.checkpoints("j2") == {"x": (16, b"progress"), "y": (16, b"progress")}
    assert {job.elapsed for job in store.jobs()} == {1.0}
    assert store.state("j2", "x", 16, 0)
    with pytest.raises(KeyError):
        store.state("j2", "x", 8, 0)
    assert not store.commit_result("j2", "cancelled", None)
    assert store.checkpoints("j2")


def test_deaths_count_until_a_commit_a_cut_the_end_or_a_return(store: Store) -> None:
    store.add_job(JOB)
    deaths = [Death("j1", variable, 1, worker, "i") for variable in ("x", "y", "z") for worker in ("v", "w")]
    for _ in range(2):
        store.add_deaths(deaths)
    assert store.deaths("j1") == tuple(deaths)
    store.commit_checkpoint("j1", "x", 8, b"progress", states_of(8), 1.0)
    store.take_back_deaths("v", "i")
    store.take_back_deaths("w", "another process")
    assert store.deaths("j1") == (Death("j1", "y", 1, "w", "i"), Death("j1", "z", 1, "w", "i"))
    store.commit_cuts("j1", {"y": b"cut"})
    assert store.deaths("j1") == (Death("j1", "z", 1, "w", "i"),)
    store.commit_result("j1", "cancelled", None)
    assert store.deaths("j1") == ()


LAYOUT_1 = Path(__file__).with_name("store_layout_1.sql")


def test_a_store_of_layout_1_is_brought_up_to_date_and_keeps_what_it_has(tmp_path: Path) -> None:
    with contextlib.closing(sqlite3.connect(tmp_path / FILE_NAME)) as connection:
        connection.executescript(LAYOUT_1.read_text("utf-8"))
    with Store.open(tmp_path) as store:
        assert (store.cluster, store.incarnation) == ("4f2b61c09a3e", 4)
        assert [job.id for job in store.jobs()] == ["ended", "running"]
        assert store.result("ended") == '{"state": "done"}'
        assert placements_in(store, "running") == {"x": (3, b"placement"), "y": (2, None)}
        assert store.cuts("running") == {"y": b"cut"}
        assert store.checkpoints("running") == {}
        assert [job.priority for job in store.jobs()] == [0, 0]
        store.add_events([EventRecord("running", "now", "submitted", "{}")])
        assert len(store.events("running", 0, 9)) == 1
        assert store.commit_checkpoint("running", "x", 8, b"progress", states_of(8), 1.0)
    with Store.open(tmp_path) as store:
        assert store.checkpoints("running") == {"x": (8, b"progress")}


def test_a_coordinator_whose_store_was_opened_by_another_writes_nothing_more(tmp_path: Path) -> None:
    """Where locks on files do not reach, as on some network drives, the incarnation still does."""
    with Store.open(tmp_path) as store:
        store.add_job(JOB)
        store.check()
        with contextlib.closing(sqlite3.connect(tmp_path / FILE_NAME)) as other:
            other.execute("UPDATE realm SET incarnation = incarnation + 1")
            other.commit()
        for act in (store.check, lambda: begin_term(store, "j1", "x"), lambda: checkpoint(store, 8)):
            with pytest.raises(
                StoreError, match=r"another coordinator \(incarnation 2\) has taken over.*incarnation 1"
            ):
                act()


def test_a_checkpoint_of_a_job_that_was_deleted_while_it_waited_to_be_written_is_dropped(store: Store) -> None:
    store.add_job(JOB)
    store.commit_result("j1", "cancelled", "{}")
    store.delete_job("j1")
    assert not checkpoint(store, 8)
    assert store.checkpoints("j1") == {}


def test_a_store_counts_the_seconds_that_it_is_served_in_all_lives(tmp_path: Path) -> None:
    now = [1000.0]
    with Store.open(tmp_path, lambda: now[0]) as first:
        first.add_job(JOB)
        now[0] += 60.0
        first.keep_served()
        now[0] += 30.0
        first.commit_result("j1", "done", "{}")
        now[0] += 5.0  # lost with this coordinator
    now[0] = 3.0  # the machine was started again
    with Store.open(tmp_path, lambda: now[0]) as second:
        now[0] += 10.0
        assert second.served_s == 100.0
        job = second.job("j1")
        assert job is not None
        assert job.ended_at == 90.0


def test_what_was_prepared_is_written_again_where_another_job_took_it_along_when_it_was_deleted() -> None:
    with Store.open(None) as store:
        for name in ("j1", "j2"):
            store.add_job(JobRecord(name, name, "{}", put_blob(store, b"table"), "2026"))
        made = b"d" * (CHUNK_SIZE + 1)
        store.keep_prepared("j1", made, b"rest")
        store.commit_result("j1", "done", "{}")
        write = store._write_blob

        def delete(digest: str, data: bytes) -> None:
            write(digest, data)
            store.delete_job("j1")  # the second time there is none

        store._write_blob = delete  # type: ignore[method-assign]
        assert store.keep_prepared("j2", made, b"rest") is None
        assert store.get_blob(hashlib.sha256(made).hexdigest()) == made
        assert store.unused_blobs() == ()
