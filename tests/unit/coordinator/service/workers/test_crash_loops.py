"""What is thought of an archipelago whose workers die."""

import pytest

from atoll.errors import LocalProtocolError
from atoll_coordinator.service.workers.crash_loops import POISON_TRANSITIONS, Suspicion


def dead(number: int) -> tuple[str, str]:
    return f"w{number}", f"i{number}"


def after(deaths: int) -> Suspicion:
    suspicion = Suspicion()
    for term in range(1, deaths + 1):
        assert suspicion.died(term, dead(term))
    return suspicion


@pytest.mark.parametrize(
    ("deaths", "state"), [(0, "sound"), (1, "once"), (2, "twice"), (3, "isolated"), (4, "again"), (5, "condemned")]
)
def test_each_term_that_ends_by_a_death_makes_it_worse(deaths: int, state: str) -> None:
    suspicion = after(deaths)
    assert suspicion.state == state
    assert suspicion.is_isolated == (deaths in (3, 4))


def test_a_commit_makes_it_sound_again_whatever_was_before() -> None:
    for deaths in range(5):
        suspicion = after(deaths)
        assert suspicion.commits(16)
        assert suspicion.state == "sound"
        assert suspicion.died(9, dead(9))
        assert suspicion.state == "once"


def test_a_commit_of_an_epoch_that_was_committed_before_is_no_news() -> None:
    suspicion = Suspicion()
    assert suspicion.commits(32)
    assert suspicion.died(1, dead(1))
    assert not suspicion.commits(16)
    assert not suspicion.commits(32)
    assert suspicion.state == "once"


def test_several_deaths_under_one_term_count_once() -> None:
    suspicion = Suspicion()
    assert suspicion.died(1, dead(1))
    assert not suspicion.died(1, dead(2))
    assert suspicion.state == "once"


def test_a_process_that_comes_back_takes_its_death_back() -> None:
    for deaths in range(1, 5):
        suspicion, before = after(deaths), after(deaths - 1).state
        assert suspicion.came_back(dead(deaths))
        assert suspicion.state == before
        assert not suspicion.came_back(dead(deaths))


def test_a_term_that_others_died_under_too_still_counts() -> None:
    suspicion = after(1)
    suspicion.died(1, dead(7))
    assert not suspicion.came_back(dead(1))
    assert suspicion.state == "once"
    assert suspicion.came_back(dead(7))
    assert suspicion.state == "sound"


def test_another_process_of_the_same_name_takes_nothing_back() -> None:
    suspicion = after(2)
    assert not suspicion.came_back(("w1", "another"))
    assert suspicion.state == "twice"


def test_what_is_condemned_stays_so() -> None:
    suspicion = after(5)
    assert not suspicion.died(6, dead(6))
    assert not suspicion.came_back(dead(5))
    suspicion.commits(16)
    assert suspicion.state == "condemned"
    assert POISON_TRANSITIONS["condemned"] == {}
    with pytest.raises(LocalProtocolError, match="has no death"):
        suspicion._step("death")
