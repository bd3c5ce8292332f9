"""A few hundred of the schedules of `benchmarks.scheduling`, a small crowd, and that its checks can fail."""

from collections.abc import Callable

import pytest

from atoll_coordinator.service.job_controller import JobController
from atoll_coordinator.service.scheduling.fair_share import FairShare
from benchmarks.scheduling import Play, Setting, jain, play, play_bytes, setting_of


@pytest.mark.parametrize("first", range(0, 200, 50))
def test_whatever_users_do_small_jobs_are_served_in_time_and_nobody_starves(first: int) -> None:
    assert {seed: wrong for seed in range(first, first + 50) if (wrong := play(seed))} == {}


def test_whatever_users_store_limits_hold_to_the_byte() -> None:
    assert {seed: wrong for seed in range(40) if (wrong := play_bytes(seed))} == {}


def test_users_who_always_want_more_have_equal_shares_however_many_jobs_they_have() -> None:
    played = Play(Setting(3, 5.0, 1.0, 1.0, ("greedy",) * 5 + ("endless",) * 7), 1)
    played.begin()
    for _ in range(1000):
        played.step()
    assert played.wrong == []
    assert jain(list(played.served_s.values())) >= 0.95
    assert len(played.served_s) == 12


@pytest.mark.parametrize(
    ("owner", "method", "broken"),
    [(FairShare, "charge", lambda *_: None), (FairShare, "_round_of", lambda *_: 0)],
)
def test_a_share_that_is_not_fair_is_noticed(
    monkeypatch: pytest.MonkeyPatch, owner: type, method: str, broken: Callable[..., object]
) -> None:
    seeds = [seed for seed in range(40) if len(setting_of(seed).kinds) > 3]
    monkeypatch.setattr(owner, method, broken)
    assert any(play(seed) for seed in seeds)


def test_bytes_beyond_a_limit_are_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(JobController, "_fitting", lambda self, job, text: text)
    assert any(play_bytes(seed) for seed in range(10))
