"""Scaling: speed-ups, waiting as the system's account of threads tells it, and what goes over the bus."""

import json

import pytest

from atoll_core.wire import topics
from atoll_core.wire.bus.interface import Message
from atoll_core.wire.bus.zenoh_bus import open_router
from atoll_core.wire.messages.views import JobView, VariableView
from benchmarks.operations.scaling import (
    Findings,
    Round,
    Timing,
    differing,
    main,
    speed_ups,
    timings_table,
    waiting,
)
from benchmarks.operations.watching import Idleness, Load, Traffic, busy, counting, idle_share, kind_of, load_of

TIMINGS = [
    Timing(1, 0, 10.0, 10**8, "a", 0.0),
    Timing(1, 1, 20.0, 2 * 10**8, "b", 0.01),
    Timing(2, 0, 5.0, 10**8, "a", 0.03),
    Timing(2, 1, 12.5, 2 * 10**8, "b", 0.05),
]
LOADS = [Load(1, 0.0, 0.0, 1.0, 2000.0, 1.0, 200.0), Load(2, 8.0, 150_000.0, 2.0, 3000.0, 2.0, 400.0)]


def test_the_speed_up_is_the_median_over_seeds():
    assert speed_ups(TIMINGS) == {1: 1.0, 2: pytest.approx(1.8)}


def test_digests_must_not_depend_on_the_number_of_workers():
    assert differing(TIMINGS) == []
    assert differing([*TIMINGS, Timing(3, 1, 1.0, 1, "c", None)]) == [1]


def test_waiting_is_a_median_of_what_is_known():
    assert waiting(TIMINGS[2:]) == pytest.approx(0.04)
    assert waiting([Timing(1, 0, 1.0, 1, "a", None)]) is None


def test_two_workers_are_compared_with_the_throughput_of_two_services():
    assert Round(0, together=5.0, apart=(10.0, 10.0)).efficiency == pytest.approx(1.0)
    assert Round(0, together=5.0, apart=(8.0, 8.0)).efficiency == pytest.approx(0.8)


def test_the_table_has_a_line_for_each_number_of_workers():
    rows = [line.split() for line in timings_table(TIMINGS, LOADS).splitlines()[1:]]
    assert rows[1] == ["2", "8.75", "1.80", "4.0%", "18.00", "8.0", "150.0", "2.0", "3.0", "2.0", "0.4"]
    assert rows[0][:4] == ["1", "15.00", "1.00", "0.5%"]


def test_everything_is_written_and_shown(tmp_path, capsys):
    findings = Findings(["--epochs", "3"], tmp_path / "f.json", TIMINGS, LOADS, [Round(0, 5.0, (9.0, 9.0))])
    findings.write()
    findings.show()
    contents = json.loads((tmp_path / "f.json").read_text("utf-8"))
    assert contents["speed_up"]["2"] == pytest.approx(1.8)
    assert contents["rounds"][0]["efficiency"] == pytest.approx(0.9)
    printed = capsys.readouterr().out
    assert "90.0% in the median" in printed
    assert "the same digests" in printed


def account(folder, pid, thread, running_s, queued_s):
    path = folder / str(pid) / "task" / str(thread)
    path.mkdir(parents=True, exist_ok=True)
    (path / "schedstat").write_text(f"{running_s * 10**9:.0f} {queued_s * 10**9:.0f} 7\n")


def test_a_thread_that_waits_for_a_core_does_not_wait_for_migrants(tmp_path):
    account(tmp_path, 10, 10, 1.0, 0.0)
    account(tmp_path, 10, 11, 5.0, 1.0)
    before = busy(10, tmp_path)
    assert before == {10: 1.0, 11: 6.0}
    account(tmp_path, 10, 11, 9.0, 4.0)
    assert idle_share(before, busy(10, tmp_path), 10.0) == pytest.approx(0.3)


def test_without_an_account_of_threads_nothing_is_said(tmp_path):
    assert busy(10, tmp_path) == {}
    assert idle_share({}, {}, 1.0) is None
    assert idle_share({1: 1.0}, {1: 2.0}, 0.0) is None


def view(elapsed, *epochs, finished=False):
    its = [
        VariableView(variable=f"v{k}", lhs="", epoch=epoch, finished=finished and k == 0)
        for k, epoch in enumerate(epochs)
    ]
    return JobView(
        job="a", name="b", state="running", seed=0, preset="default", submitted="", elapsed=elapsed, workers=1,
        point_evaluations=0, variables=tuple(its),
    )  # fmt: skip


def test_workers_are_watched_from_the_first_epoch_until_the_first_end(tmp_path):
    """Of the ten seconds between the two looks that count, one worker sleeps 1 and the other 3."""
    idleness = Idleness((10, 20), tmp_path)
    for elapsed, one, two, look in [
        (0.0, 0.0, 0.0, view(0.0)),
        (1.0, 0.5, 0.5, view(1.0, 1, 0)),
        (2.0, 1.0, 1.0, view(2.0, 1, 1)),
        (12.0, 10.0, 8.0, view(12.0, 3, 2)),
        (20.0, 10.0, 8.0, view(20.0, 4, 3, finished=True)),
    ]:
        account(tmp_path, 10, 11, one, 0.0)
        account(tmp_path, 20, 21, two, 0.0)
        idleness.look(look)
        assert elapsed == look.elapsed
    assert idleness.share() == pytest.approx(0.2)


def test_one_look_is_not_enough(tmp_path):
    idleness = Idleness((10,), tmp_path)
    assert idleness.share() is None
    account(tmp_path, 10, 11, 1.0, 0.0)
    idleness.look(view(1.0, 1))
    assert idleness.share() is None


@pytest.mark.parametrize(
    ("key", "kind"),
    [
        (topics.mail("r", "w0", "w1"), "migrants"),
        (topics.worker("r", "w0", "report"), "report"),
        (topics.worker("r", "w0", "status"), "status"),
        (topics.control("r"), "control"),
        (topics.job("r", "j"), "other"),
    ],
)
def test_messages_are_told_apart_by_key(key, kind):
    assert kind_of(key) == kind


def test_the_load_is_by_epoch_and_that_of_heartbeats_by_second():
    traffic = Traffic()
    for _ in range(6):
        traffic.add(Message(topics.mail("r", "w0", "w1"), b"x" * 100))
        traffic.add(Message(topics.worker("r", "w0", "status"), b"x" * 10))
        traffic.add(Message(topics.worker("r", "w0", "report"), b"x"))
    load = load_of(2, traffic, epochs=3, archipelagos=1, seconds=2.0)
    assert load == Load(2, 3.0, 300.0, 2.0, 2.0, 3.0, 30.0)


def test_what_is_put_on_the_bus_is_counted():
    with open_router("tcp/127.0.0.1:0") as router:
        with counting(router.endpoint, "r1") as traffic:
            router.put(topics.worker("r1", "w0", "report"), b"12345")
            router.put(topics.worker("another", "w0", "report"), b"1")
        assert traffic.messages == {"report": 1}
        assert traffic.size_bytes == {"report": 5}


@pytest.mark.parametrize(("text", "numbers"), [("2", [2]), ("4,1-2", [1, 2, 4])])
def test_numbers_of_workers(text, numbers):
    assert main.parser.parse_args(["--workers", text]).workers == numbers


@pytest.mark.parametrize(
    "words", [["--workers", "0"], ["--workers", "two"], ["--system", "none"], ["--epochs", "0"], ["--step", "nan"]]
)
def test_other_options_are_refused(words, capsys):
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 2
    assert "error:" in capsys.readouterr().err
