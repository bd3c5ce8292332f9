"""Parties take turns, whatever one of them asks, and under how many names."""

from atoll_coordinator.service.requests.question_queue import (
    MAX_BYTES,
    MAX_BYTES_OF_PARTY,
    MAX_OF_CLIENT,
    MAX_OF_PARTY,
    MAX_WAITING,
    QuestionQueue,
)


def test_parties_take_turns_and_within_them_their_clients() -> None:
    queue = QuestionQueue[str]()
    for question in ("ann-1 a", "ann-1 b", "ann-1 c", "bob-1 a", "ann-2 a", "bob-1 b", "eve-1 a"):
        client = question.partition(" ")[0]
        assert queue.add(client.partition("-")[0], client, question)
    taken = [queue.take() for _ in range(8)]
    assert taken == ["ann-1 a", "bob-1 a", "eve-1 a", "ann-2 a", "bob-1 b", "ann-1 b", "ann-1 c", None]
    assert len(queue) == 0


def test_too_many_questions_of_one_client_are_refused_and_others_still_heard() -> None:
    queue = QuestionQueue[int]()
    taken = [queue.add("ann", "ann-1", number) for number in range(MAX_OF_CLIENT + 2)]
    assert taken == [*[True] * MAX_OF_CLIENT, False, False]
    assert queue.add("ann", "ann-2", 0)
    assert queue.add("bob", "bob-1", 0)
    assert (queue.refused, len(queue)) == (2, MAX_OF_CLIENT + 2)


def test_a_party_with_thousands_of_names_keeps_no_other_from_its_next_turn() -> None:
    queue = QuestionQueue[str]()
    taken = [queue.add("mal", f"mal-{number}", "m") for number in range(10 * MAX_WAITING)]
    assert sum(taken) == MAX_OF_PARTY
    assert queue.add("ann", "ann-1", "a")
    assert [queue.take(), queue.take()] == ["m", "a"]


def test_the_questions_of_all_are_bounded() -> None:
    queue = QuestionQueue[int]()
    taken = [queue.add(f"p{number}", "c", number) for number in range(MAX_WAITING + 1)]
    assert taken == [*[True] * MAX_WAITING, False]


def test_the_bytes_of_a_party_and_of_all_are_bounded() -> None:
    queue = QuestionQueue[int]()
    assert queue.add("p0", "c", 0, MAX_BYTES_OF_PARTY - 10)
    assert not queue.add("p0", "d", 0, 11)
    for number in range(1, MAX_BYTES // MAX_BYTES_OF_PARTY):
        assert queue.add(f"p{number}", "c", number, MAX_BYTES_OF_PARTY)
    assert not queue.add("q", "c", 9, 11)
    assert queue.add("q", "c", 9, 10)
    assert (queue.take(), queue.add("r", "c", 9, 11)) == (0, True)
    assert queue.refused == 2


def test_a_party_that_is_busy_is_passed_over_and_keeps_its_turn() -> None:
    queue = QuestionQueue[int]()
    for party, number in (("ann", 1), ("bob", 2), ("ann", 3)):
        queue.add(party, party, number)
    assert queue.take_of({"ann"}) == ("bob", 2)
    assert queue.take_of({"ann"}) == ("", None)
    assert [queue.take(), queue.take(), len(queue)] == [1, 3, 0]
