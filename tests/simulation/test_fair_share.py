"""A few hundred of the schedules of `benchmarks.scheduling`, a small crowd, and that its checks can fail."""

import pytest

from benchmarks.scheduling import Play, Setting, jain, play, play_bytes


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
