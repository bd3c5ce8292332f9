"""Mutated messages of every kind: none is more than refused, and a job beside them comes to its result."""

import logging

import pytest

from tests.simulation.hostile_messages import Mutator, Overheard, Score, fuzz_decoder, fuzz_sessions, overhear

KINDS = {
    "Answer",
    "ClientRequest",
    "Control",
    "EpochReport",
    "Greeting",
    "GreetingAnswer",
    "Pull",
    "PullAnswer",
}


@pytest.fixture(scope="module")
def messages() -> list[Overheard]:
    return overhear()


def test_messages_of_every_kind_are_overheard(messages: list[Overheard]) -> None:
    assert {message.kind.__name__ for message in messages} >= KINDS | {"WorkerStatus"}


def test_a_mutated_message_is_a_message_or_a_refusal(messages: list[Overheard]) -> None:
    score = Score()
    fuzz_decoder(messages, 3000, Mutator(1), score)
    assert score.refused.keys() >= KINDS
    assert score.refused.total() > 2000
    assert score.understood.total() > 20


def test_a_stranger_who_says_them_changes_no_result(
    messages: list[Overheard], caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.ERROR)
    score = Score()
    fuzz_sessions(messages, 300, Mutator(2), score)
    assert score.sent >= 300
    assert score.rejects > 150
