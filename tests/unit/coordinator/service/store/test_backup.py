"""A copy of a store that is written meanwhile is one instant of it; a store made of a copy is a cluster of its own."""

import sqlite3
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from atoll_coordinator.service.store import backup
from atoll_coordinator.service.store.backup import back_up, check_copy, restore
from atoll_coordinator.service.store.holdings import ALL
from atoll_coordinator.service.store.jobs import JobRecord
from atoll_coordinator.service.store.schema import FILE_NAME
from atoll_coordinator.service.store.store import Store
from atoll_core.errors import StoreError, WrongStoreError


def job(number: int, size: int = 100) -> JobRecord:
    return JobRecord(
        f"j{number}", "name", "x" * size, "", "2026-01-01T00:00:00Z", submitter=f"user{number}", shared=number % 2
    )  # fmt: skip


@pytest.fixture
def state(tmp_path: Path) -> Path:
    """Return the folder of a store with two jobs."""
    with Store.open(tmp_path / "state") as store:
        for number in range(2):
            store.add_job(job(number))
        store.commit_result("j1", "done", "{}")
    return tmp_path / "state"


@pytest.fixture
def copy(state: Path, tmp_path: Path) -> Path:
    back_up(state, tmp_path / "copy")
    return tmp_path / "copy"


def files(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_a_copy_comes_to_an_end_and_is_of_one_instant_while_commits_come(
    state: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SQLite begins a backup anew when the file is changed meanwhile: a commit after each step would go on for ever."""
    monkeypatch.setattr(backup, "STEP_PAGES", 4)
    with Store.open(state) as store:
        for number in range(2, 200):
            store.add_job(job(number, 4000))
        steps: list[tuple[int, int]] = []

        def commit(done: int, pages: int) -> None:
            steps.append((done, pages))
            store.add_job(job(1000 + len(steps), 4000))

        found = back_up(state, tmp_path / "copy", commit)
        assert found.jobs == 200
        assert len(steps) > 20
        assert store.job(f"j{1000 + len(steps)}") is not None
        assert [done for done, _ in steps] == sorted({done for done, _ in steps}), "no step is done twice"


def test_commits_do_not_wait_for_a_copy(state: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The copy stops in the midst; were the store locked, a commit would fail after the limit."""
    monkeypatch.setattr(backup, "STEP_PAGES", 1)
    reached, goes_on = threading.Event(), threading.Event()

    def stop(done: int, pages: int) -> None:
        reached.set()
        assert goes_on.wait(30)

    with Store.open(state) as store:
        copying = threading.Thread(target=back_up, args=(state, tmp_path / "copy", stop))
        copying.start()
        try:
            assert reached.wait(30)
            store.add_job(job(2))
        finally:
            goes_on.set()
            copying.join(30)
    assert check_copy(tmp_path / "copy", "it").jobs == 2


def test_a_restored_store_has_the_jobs_and_a_name_of_its_own(copy: Path, state: Path, tmp_path: Path) -> None:
    restored = restore(copy, tmp_path / "new")
    assert (restored.copy.jobs, restored.former) == (2, None)
    with Store.open(state) as old, Store.open(tmp_path / "new") as new:
        assert new.jobs() == old.jobs()
        assert [(job.submitter, job.shared) for job in new.jobs()] == [("user0", 0), ("user1", 1)]
        assert (new.held("user1"), new.held(ALL)) == (old.held("user1"), old.held(ALL))
        assert new.held("user1").stored > 0
        assert new.cluster == restored.cluster
        assert new.cluster != old.cluster == restored.copy.cluster
    assert {file.stat().st_mode & 0o777 for file in (copy, *(tmp_path / "new").iterdir())} == {0o600}
    assert check_copy(copy, "it").cluster == restored.copy.cluster, "the copy stays as it was"
    assert restore(copy, tmp_path / "third").cluster not in (restored.cluster, restored.copy.cluster)


def test_a_store_that_is_there_is_put_aside_only_when_told(copy: Path, state: Path) -> None:
    with Store.open(state) as store:
        store.add_job(job(2))
    with pytest.raises(StoreError, match=r"has a store already.*--replace"):
        restore(copy, state)
    restored = restore(copy, state, replaces=True)
    assert restored.former == state / "replaced-1.sqlite3"
    assert check_copy(restored.former, "it").jobs == 3
    again = restore(copy, state, replaces=True)
    assert again.former == state / "replaced-2.sqlite3"
    with Store.open(state) as store:
        assert [each.id for each in store.jobs()] == ["j0", "j1"]


@pytest.mark.parametrize("replaces", [False, True])
def test_what_a_store_left_that_was_moved_away_is_not_played_into_the_restored_one(
    copy: Path, state: Path, tmp_path: Path, replaces: bool
) -> None:
    """The operator's second mistake: the damaged file is moved away by hand, and the WAL beside it is not."""
    left = {f"{FILE_NAME}{end}": file for end in ("-wal", "-shm") for file in [state / f"{FILE_NAME}{end}"]}
    with Store.open(state) as store:
        store.add_job(job(2))
        kept = {name: file.read_bytes() for name, file in left.items()}
    (state / FILE_NAME).rename(tmp_path / "damaged.sqlite3")
    for name, contents in kept.items():
        (state / name).write_bytes(contents)
    (state / f"{FILE_NAME}-journal").write_bytes(b"a journal")
    restored = restore(copy, state, replaces=replaces)
    assert restored.former is None
    assert [path.name for path in restored.aside] == [f"replaced-1.sqlite3-{end}" for end in ("wal", "shm", "journal")]
    assert restored.aside[0].read_bytes() == kept[f"{FILE_NAME}-wal"], "it may be of use with the file that was moved"
    with Store.open(state) as store:
        assert store.cluster == restored.cluster
        assert [each.id for each in store.jobs()] == ["j0", "j1"]
        store.add_job(job(7))


def test_a_store_is_not_begun_anew_over_what_is_left_of_one_that_was_moved_away(state: Path, tmp_path: Path) -> None:
    (state / FILE_NAME).rename(tmp_path / "moved")
    (state / f"{FILE_NAME}-wal").write_bytes(b"frames of the store that was moved away")
    with pytest.raises(WrongStoreError, match="put the store back"):
        Store.open(state)
    assert files(state) == {"lock", f"{FILE_NAME}-wal"}


def test_no_copy_is_made_where_sqlite_left_something_of_another(state: Path, tmp_path: Path) -> None:
    (tmp_path / "copy-wal").write_bytes(b"of a copy that was deleted")
    with pytest.raises(StoreError, match="copy-wal exists already; name another file"):
        back_up(state, tmp_path / "copy")


def test_a_restored_store_that_is_another_one_is_not_called_restored(
    copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(backup, "_copy_renamed", lambda source, draft: (draft.write_bytes(source.read_bytes()), "x")[1])
    with pytest.raises(StoreError, match=r"holds 2 jobs of the cluster .*, but 2 of x were expected"):
        restore(copy, tmp_path / "new")


def test_a_damaged_store_can_be_replaced(copy: Path, state: Path) -> None:
    (state / FILE_NAME).write_bytes(b"no database at all" * 1000)
    restored = restore(copy, state, replaces=True)
    assert restored.former is not None
    with Store.open(state) as store:
        assert len(store.jobs()) == 2


def test_no_store_is_made_under_a_coordinator(copy: Path, state: Path) -> None:
    with Store.open(state) as store:
        with pytest.raises(StoreError, match="in use by another coordinator"):
            restore(copy, state, replaces=True)
        store.check()


def test_damage_in_a_copy_is_found_and_nothing_is_made_of_it(copy: Path, tmp_path: Path) -> None:
    contents = bytearray(copy.read_bytes())
    contents[4096 * 3 : 4096 * 5] = b"\xff" * 8192
    copy.write_bytes(contents)
    with pytest.raises(StoreError, match=r"copy .* is damaged|malformed.*use another copy"):
        restore(copy, tmp_path / "new")
    assert files(tmp_path / "new") == {"lock"}
    copy.write_bytes(contents[:6000])
    with pytest.raises(StoreError, match=r"use another copy|check that there is room"):
        restore(copy, tmp_path / "new")
    assert files(tmp_path / "new") == {"lock"}


@pytest.mark.parametrize("contents", [b"", b"something else, but long enough to be looked into" * 100])
def test_what_is_no_copy_is_refused(contents: bytes, tmp_path: Path) -> None:
    (tmp_path / "copy").write_bytes(contents)
    with pytest.raises(StoreError, match=r"no store|not a database"):
        restore(tmp_path / "copy", tmp_path / "new")
    assert files(tmp_path / "new") == {"lock"}


def test_a_database_of_another_program_is_refused(tmp_path: Path) -> None:
    foreign = sqlite3.connect(tmp_path / "copy")
    foreign.execute("CREATE TABLE jobs (id TEXT)")
    foreign.close()
    with pytest.raises(StoreError, match="not a store of Atoll"):
        restore(tmp_path / "copy", tmp_path / "new")


def test_what_is_missing_or_there_already_is_said(state: Path, copy: Path, tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"there is no store in .*nowhere; name the folder"):
        back_up(tmp_path / "nowhere", tmp_path / "other")
    with pytest.raises(StoreError, match="exists already; name another file"):
        back_up(state, copy)
    with pytest.raises(StoreError, match="cannot be written: no such file or directory; name another"):
        back_up(state, tmp_path / "nowhere" / "copy")
    with pytest.raises(StoreError, match=r"there is no copy .*none; name a file"):
        restore(tmp_path / "none", tmp_path / "new")
    assert not (tmp_path / "nowhere").exists()


@pytest.mark.parametrize("verb", ["backup", "restore"])
def test_a_disk_that_is_full_is_one_sentence_and_leaves_nothing(verb: str, state: Path, tmp_path: Path) -> None:
    with Store.open(state) as store:
        for number in range(2, 40):
            store.add_job(job(number, 4000))
    back_up(state, tmp_path / "good")
    target = "copy" if verb == "backup" else "good"
    place = "state" if verb == "backup" else "new"
    program = (
        "import resource, sys\nresource.setrlimit(resource.RLIMIT_FSIZE, (40960, 40960))\n"
        "from atoll.cli.main import main\nsys.exit(main(sys.argv[1:]))"
    )
    ended = subprocess.run(
        [sys.executable, "-B", "-c", program, verb, target, "--state", place],
        cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert ended.returncode == 1, "it may pass, and is no mistake in the options"
    assert "cannot be written" in ended.stderr
    assert "check that there is room" in ended.stderr
    assert len(ended.stderr.splitlines()) == 1
    assert files(tmp_path) - {"new"} == {"state", "good"}
    assert not (tmp_path / "new").exists() or files(tmp_path / "new") == {"lock"}
