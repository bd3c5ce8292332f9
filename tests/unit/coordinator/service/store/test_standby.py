"""A coordinator on standby takes a store over from one that has died or hangs, and from no other."""

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from atoll_coordinator.service.store import standby
from atoll_coordinator.service.store.lock import LOCK_NAME, Beat, Lock, StoreInUseError, last_beat
from atoll_coordinator.service.store.standby import LOOK_S, SILENCE_S, Silence, Standby
from atoll_coordinator.service.store.store import Store
from atoll_core.errors import StoreError


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Store]:
    with Store.open(tmp_path / "state") as store:
        yield store


class Waiting:
    """A standby whose clock makes great steps, and that stops after so many looks."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, directory: Path, looks: int = 200) -> None:
        self.said: list[str] = []
        self.obstacle: str | None = None
        self.looks = looks
        self.before_look = lambda look: None
        self._stop = threading.Event()
        monkeypatch.setattr(self._stop, "wait", self._pass)
        monkeypatch.setattr(standby.time, "monotonic", lambda: self._now)
        self._now, self._look = 0.0, 0
        self._standby = Standby(directory, self._stop, lambda: self.obstacle, self.said.append)

    def store(self) -> Store | None:
        return self._standby.store()

    def _pass(self, seconds: float) -> bool:
        self._now += seconds
        self._look += 1
        self.before_look(self._look)
        if self._look >= self.looks:
            self._stop.set()
        return True


def test_a_death_is_noticed_at_the_next_look(monkeypatch: pytest.MonkeyPatch, served: Store, tmp_path: Path) -> None:
    waiting = Waiting(monkeypatch, tmp_path / "state")
    waiting.before_look = lambda look: served.close() if look == 3 else None
    store = waiting.store()
    assert store is not None
    assert store.incarnation == served.incarnation + 1
    store.close()
    (said,) = waiting.said
    assert f"process {os.getpid()}" in said
    assert "on standby and takes over" in said


def test_a_coordinator_that_gets_on_keeps_its_store(
    monkeypatch: pytest.MonkeyPatch, served: Store, tmp_path: Path
) -> None:
    waiting = Waiting(monkeypatch, tmp_path / "state")
    state = tmp_path / "state" / LOCK_NAME
    waiting.before_look = lambda look: os.utime(state, (look, look)) if look % 4 == 0 else None
    assert waiting.store() is None
    served.check()


def test_a_coordinator_that_hangs_is_replaced_and_ends_when_it_goes_on(
    monkeypatch: pytest.MonkeyPatch, served: Store, tmp_path: Path
) -> None:
    waiting = Waiting(monkeypatch, tmp_path / "state")
    store = waiting.store()
    assert store is not None
    with store:
        with pytest.raises(StoreError, match=r"another coordinator \(incarnation 2\) has taken over the store"):
            served.beat()
        store.beat()
        with pytest.raises(StoreInUseError):
            Lock(tmp_path / "state")
        served.close()  # gives back a lock that is no longer the directory's
        with pytest.raises(StoreInUseError):
            Lock(tmp_path / "state")


def test_a_coordinator_that_hangs_keeps_its_store_while_ours_could_not_serve(
    monkeypatch: pytest.MonkeyPatch, served: Store, tmp_path: Path
) -> None:
    waiting = Waiting(monkeypatch, tmp_path / "state")
    waiting.obstacle = "the port is in use"
    assert waiting.store() is None
    served.check()
    assert [said for said in waiting.said if "its place cannot be taken: the port is in use" in said] != []


def test_a_store_that_hangs_in_a_transaction_is_waited_for(
    monkeypatch: pytest.MonkeyPatch, served: Store, tmp_path: Path
) -> None:
    monkeypatch.setattr("atoll_coordinator.service.store.schema.BUSY_LIMIT_S", 0.05)
    waiting = Waiting(monkeypatch, tmp_path / "state", looks=int(SILENCE_S / LOOK_S) + 20)
    with served._transaction():
        waiting.before_look = lambda look: served._connection.execute("ROLLBACK") if look == waiting.looks - 5 else None
        with pytest.raises(StoreError):  # noqa: PT012  # the transaction itself finds that it is over
            store = waiting.store()
            assert store is not None
            store.close()
            raise StoreError("done")
    assert any("cannot be taken from it yet" in said and "end its process" in said for said in waiting.said)


def test_a_lock_of_an_older_version_never_beats_and_is_never_taken_for_hung(
    monkeypatch: pytest.MonkeyPatch, served: Store, tmp_path: Path
) -> None:
    (tmp_path / "state" / LOCK_NAME).write_text("123\n")
    assert last_beat(tmp_path / "state") is None
    assert Waiting(monkeypatch, tmp_path / "state").store() is None
    served.check()


def test_of_two_on_standby_one_takes_over(served: Store, tmp_path: Path) -> None:
    beat = last_beat(tmp_path / "state")
    assert beat is not None
    first = Lock.seize(tmp_path / "state", beat)
    assert first is not None
    assert Lock.seize(tmp_path / "state", beat) is None, "the first gets on"
    first.release()


def test_a_look_that_comes_late_says_nothing_about_what_it_did_not_see() -> None:
    silence, beat = Silence(), Beat(1, 1)
    assert not silence.look(beat, 0.0)
    assert not silence.look(beat, 1000.0), "whoever looks was stopped as well, perhaps with all of the machine"
    assert not silence.look(Beat(1, 2), 1001.0)
    looks = [silence.look(Beat(1, 2), 1001.0 + LOOK_S * number) for number in range(1, int(SILENCE_S / LOOK_S) + 1)]
    assert looks.index(True) == len(looks) - 1


def test_a_lock_is_gone_with_its_process(tmp_path: Path) -> None:
    program = (
        "import sys, time\nfrom pathlib import Path\nfrom atoll_coordinator.service.store.lock import Lock\n"
        "lock = Lock(Path(sys.argv[1]))\nprint('locked', flush=True)\ntime.sleep(600)"
    )
    holder = subprocess.Popen([sys.executable, "-c", program, str(tmp_path)], stdout=subprocess.PIPE)
    assert holder.stdout is not None
    try:
        assert holder.stdout.readline() == b"locked\n"
        with pytest.raises(StoreInUseError, match=f"process {holder.pid}"):
            Lock(tmp_path)
    finally:
        holder.kill()
        holder.wait(30)
        holder.stdout.close()
    Lock(tmp_path).release()
