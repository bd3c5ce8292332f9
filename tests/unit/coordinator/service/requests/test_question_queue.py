"""Parties take turns, whatever one of them asks, and under how many names."""

from atoll_coordinator.service.requests.waiting import QUESTIONS
from atoll_core.wire.bus.queues import Turns


def test_parties_take_turns_and_within_them_their_clients() -> None:
    queue = Turns[str](QUESTIONS)
    for question in ("ann-1 a", "ann-1 b", "ann-1 c", "bob-1 a", "ann-2 a", "bob-1 b", "eve-1 a"):
        client = question.partition(" ")[0]
        assert queue.add(client.partition("-")[0], client, question)
    taken = [queue.take() for _ in range(8)]
    assert taken == ["ann-1 a", "bob-1 a", "eve-1 a", "ann-2 a", "bob-1 b", "ann-1 b", "ann-1 c", None]
    assert len(queue) == 0


def test_too_many_questions_of_one_client_are_refused_and_others_still_heard() -> None:
    queue = Turns[int](QUESTIONS)
    taken = [queue.add("ann", "ann-1", number) for number in range(QUESTIONS.of_client + 2)]
    assert taken == [*[True] * QUESTIONS.of_client, False, False]
    assert queue.add("ann", "ann-2", 0)
    assert queue.add("bob", "bob-1", 0)
    assert (queue.refused, len(queue)) == (2, QUESTIONS.of_client + 2)


def test_a_party_with_thousands_of_names_keeps_no_other_from_its_next_turn() -> None:
    queue = Turns[str](QUESTIONS)
    taken = [queue.add("mal", f"mal-{number}", "m") for number in range(10 * QUESTIONS.of_all)]
    assert sum(taken) == QUESTIONS.of_party
    assert queue.add("ann", "ann-1", "a")
    assert [queue.take(), queue.take()] == ["m", "a"]


def test_the_questions_of_all_are_bounded() -> None:
    queue = Turns[int](QUESTIONS)
    taken = [queue.add(f"p{number}", "c", number) for number in range(QUESTIONS.of_all + 1)]
    assert taken == [*[True] * QUESTIONS.of_all, False]


def test_the_bytes_of_a_party_and_of_all_are_bounded() -> None:
    queue = Turns[int](QUESTIONS)
    assert queue.add("p0", "c", 0, QUESTIONS.bytes_of_party - 10)
    assert not queue.add("p0", "d", 0, 11)
    for number in range(1, QUESTIONS.bytes_of_all // QUESTIONS.bytes_of_party):
        assert queue.add(f"p{number}", "c", number, QUESTIONS.bytes_of_party)
    assert not queue.add("q", "c", 9, 11)
    assert queue.add("q", "c", 9, 10)
    assert (queue.take(), queue.add("r", "c", 9, 11)) == (0, True)
    assert queue.refused == 2


def test_a_party_that_is_busy_is_passed_over_and_keeps_its_turn() -> None:
    queue = Turns[int](QUESTIONS)
    for party, number in (("ann", 1), ("bob", 2), ("ann", 3)):
        queue.add(party, party, number)
    assert queue.take_of({"ann"}) == ("bob", 2)
    assert queue.take_of({"ann"}) == ("", None)
    assert [queue.take(), queue.take(), len(queue)] == [1, 3, 0]
