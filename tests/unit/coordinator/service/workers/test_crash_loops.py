"""What follows when the workers of an archipelago die again and again."""

from atoll_coordinator.service.monitoring.event_log import EventLog
from atoll_coordinator.service.store.jobs import JobRecord
from atoll_coordinator.service.store.store import Store
from atoll_coordinator.service.workers.crash_loops import FAIL_AFTER, QUARANTINE_AFTER, CrashLoop, CrashLoops
from atoll_core.wire.messages.views import EventView
from tests.blobs import put_blob

KEY = ("job", "x")


def process(number: int) -> tuple[str, str]:
    return f"w{number}", f"i{number}"


def after(deaths: int) -> CrashLoop:
    loop = CrashLoop()
    for term in range(1, deaths + 1):
        assert loop.add_death(term, process(term))
    return loop


def test_a_process_that_comes_back_takes_its_death_back() -> None:
    for deaths in range(1, FAIL_AFTER):
        loop = after(deaths)
        assert loop.withdraw(process(deaths))
        assert loop.deaths == deaths - 1
        assert not loop.withdraw(process(deaths))


def test_a_term_that_others_died_under_too_still_counts() -> None:
    loop = after(1)
    loop.add_death(1, process(7))
    assert not loop.withdraw(process(1))
    assert loop.deaths == 1
    assert loop.withdraw(process(7))
    assert loop.deaths == 0


def started(store: Store) -> CrashLoops:
    """Return the crash loops as a coordinator begins with them that is started on this store."""
    loops = CrashLoops(store, EventLog(store, lambda: "2026-01-01T00:00:00"))
    loops.recover("job")
    return loops


def events(store: Store, loops: CrashLoops) -> list[EventView]:
    return list(loops._events.read("job", 0, 99))


def test_a_commit_ends_the_quarantine_and_a_return_the_suspicion() -> None:
    with Store.open(None) as store:
        store.add_job(JobRecord("job", "", "{}", put_blob(store, b"t"), "2026-01-01T00:00:00"))
        loops = started(store)
        for number in range(QUARANTINE_AFTER):
            loops.add_death(KEY, number, process(number), "gone")
        loops.add_commit(KEY, 8)
        assert loops.loop(KEY).state == "healthy"
        loops.add_death(KEY, 9, process(9), "gone")
        loops.withdraw(process(9))
        assert loops.loop(KEY).state == "healthy"
        assert [event.event for event in events(store, loops)] == ["isolated", "pardoned", "pardoned"]
