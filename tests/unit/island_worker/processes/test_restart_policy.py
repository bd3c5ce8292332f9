"""Whether a process that has ended is started again, and when; the supervisor with children that only say they are."""

from collections.abc import Callable

import pytest

from atoll_core.errors import AtollError
from atoll_island_worker.processes import ExitReasons, RestartPolicy, Supervisor


def lived(*lives: tuple[float, int]) -> list[float | None]:
    """Let a process live so long and end so, again and again; return the pauses."""
    process, now, pauses = RestartPolicy(), 0.0, []
    for seconds, code in lives:
        process.begin(now)
        now += seconds
        pauses.append(process.end(code, now))
        now = max(now, process.due_at)
    return pauses


def test_pauses_grow_from_one_second_to_thirty() -> None:
    assert lived(*[(20.0, -9)] * 7) == [1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0]


def test_a_steady_life_makes_pauses_short_again() -> None:
    assert lived((20.0, 1), (20.0, 1), (60.0, -9), (20.0, 1)) == [1.0, 2.0, 1.0, 2.0]


@pytest.mark.parametrize("code", [0, 2, 3, 130])
def test_who_ends_in_order_or_is_refused_is_not_started_again(code: int) -> None:
    assert lived((5.0, code)) == [None]


def test_nobody_is_started_again_who_was_told_to_end() -> None:
    for was_alive in (True, False):
        process = RestartPolicy()
        process.begin(0.0)
        if was_alive:
            process.stop()
            assert process.end(-15, 1.0) is None
        else:
            process.end(-9, 1.0)
            process.stop()
            assert process.code == 0
        assert process.state == "ended"


# -------------------------------------------------------------------------------------------- supervisor


class Fake:
    """A child that ends at a moment of its own."""

    def __init__(self, pid: int, ends: Callable[[], bool], code: int) -> None:
        self.pid = pid
        self.told: list[str] = []
        self._ends = ends
        self._code = code

    def poll(self) -> int | None:
        return self._code if self._ends() or self.told else None

    def terminate(self) -> None:
        self.told.append("terminate")

    def kill(self) -> None:
        self.told.append("kill")


class Stage:
    """Time that passes as soon as it is waited for, and children that live for as long as is said."""

    def __init__(self, *plans: list[tuple[float, int]]) -> None:
        self.now = 1000.0
        self.started: list[tuple[float, str]] = []
        self._plans = {f"w-{number}": list(plan) for number, plan in enumerate(plans)}

    def run(self) -> int:
        with ExitReasons() as exit_reasons:
            starts = {name: lambda name=name: self._start(name) for name in self._plans}
            return Supervisor(starts, exit_reasons, clock=lambda: self.now, sleep=self._sleep).run()

    def _start(self, name: str) -> Fake:
        self.started.append((round(self.now - 1000.0), name))
        plan = self._plans[name]
        if not plan:
            raise AtollError("the system starts no more processes")
        seconds, code = plan.pop(0)
        end = self.now + seconds
        return Fake(len(self.started), lambda: self.now >= end, code)

    def _sleep(self, seconds: float) -> None:
        self.now += seconds


def test_a_process_that_dies_is_started_again_and_the_others_are_left_alone(capsys: pytest.CaptureFixture[str]) -> None:
    stage = Stage([(10.0, -9), (10.0, 1), (10.0, 0)], [(60.0, 0)])
    assert stage.run() == 0
    assert stage.started == [(0, "w-0"), (0, "w-1"), (11, "w-0"), (23, "w-0")]
    assert capsys.readouterr().err.splitlines() == [
        "island-worker: process 1 (w-0) was ended by signal 9; it is started again in 1 s",
        "island-worker: process 3 (w-0) has ended with exit code 1; it is started again in 2 s",
    ]


def test_one_that_dies_at_once_is_given_up_and_it_is_said_who_is_left(capsys: pytest.CaptureFixture[str]) -> None:
    stage = Stage([(0.0, -9)] * 6, [(100.0, 0)])
    assert stage.run() == 1
    assert len(stage.started) == 6
    said = capsys.readouterr().err
    assert "(w-0) was ended by signal 9, 5 deaths within a minute, and is not started again (1 other" in said
    Stage([(0.0, 1)] * 6).run()
    assert "no other" in capsys.readouterr().err


def test_a_system_that_starts_no_more_processes_fails_all_at_first_and_is_a_death_later() -> None:
    with pytest.raises(AtollError, match="starts no more"):
        Stage([]).run()
    stage = Stage([(5.0, -9)], [(30.0, 0)])
    assert stage.run() == 1
    assert len(stage.started) == 2 + 4
