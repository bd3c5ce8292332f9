"""Clients take turns, whatever one of them asks."""

from atoll_coordinator.service.requests.question_queue import MAX_BYTES, MAX_OF_CLIENT, MAX_WAITING, QuestionQueue


def test_clients_take_turns_and_each_is_answered_in_its_order() -> None:
    queue = QuestionQueue[str]()
    for question in ("a1", "a2", "a3", "b1", "c1", "b2"):
        assert queue.add(question[0], question)
    assert [queue.take() for _ in range(7)] == ["a1", "b1", "c1", "a2", "b2", "a3", None]
    assert len(queue) == 0


def test_too_many_questions_of_one_client_are_refused_and_others_still_heard() -> None:
    queue = QuestionQueue[int]()
    assert [queue.add("a", number) for number in range(MAX_OF_CLIENT + 2)] == [*[True] * MAX_OF_CLIENT, False, False]
    assert queue.add("b", 0)
    assert (queue.refused, len(queue)) == (2, MAX_OF_CLIENT + 1)


def test_the_questions_of_all_clients_are_bounded() -> None:
    queue = QuestionQueue[int]()
    taken = [queue.add(f"c{number}", number) for number in range(MAX_WAITING + 1)]
    assert taken == [*[True] * MAX_WAITING, False]


def test_the_bytes_of_all_questions_are_bounded() -> None:
    queue = QuestionQueue[int]()
    assert queue.add("a", 1, MAX_BYTES - 10)
    assert not queue.add("b", 2, 11)
    assert queue.add("b", 3, 10)
    assert (queue.take(), queue.add("c", 4, 11)) == (1, True)
    assert queue.refused == 1
