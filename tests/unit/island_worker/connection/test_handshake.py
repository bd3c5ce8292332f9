"""Joining: what greetings carry, and what their answers change."""

import pytest

from atoll import PROTOCOL_VERSION, VERSION
from atoll.errors import RefusedError
from atoll.wire.codec import decode, encode
from atoll.wire.messages.handshake import Greeting, GreetingAnswer, Refusal, Welcome
from atoll_island_worker.connection.handshake import Joined, Joining


def welcome(realm: str = "r", incarnation: int = 1) -> bytes:
    body = Welcome(realm=realm, incarnation=incarnation, protocol=1, version="0", engine=1)
    return encode(GreetingAnswer(body=body))


def test_a_greeting_names_us_and_carries_the_fingerprint_once_there_is_one() -> None:
    joining = Joining("w0", 0.0)
    first = decode(joining.hello(), Greeting).body
    assert (first.role, first.name, first.version, first.fingerprint) == ("worker", "w0", VERSION, "")
    joining.fingerprint = "f"
    second = decode(joining.hello(), Greeting).body
    assert (second.fingerprint, second.instance) == ("f", first.instance)


def test_every_process_is_another_instance() -> None:
    assert Joining("w0", 0.0).instance != Joining("w0", 0.0).instance


def test_islands_are_accepted_only_after_a_greeting_with_a_fingerprint() -> None:
    joining = Joining("w0", 0.0)
    assert joining.take("", welcome()) == Joined(is_new_realm=True, is_restart=False, greets_again=False)
    assert not joining.is_accepted
    joining.fingerprint = "f"
    assert joining.take("", welcome()).greets_again
    assert joining.take("f", welcome()) == Joined(is_new_realm=False, is_restart=False, greets_again=False)
    assert joining.is_accepted


def test_another_incarnation_or_realm_is_a_restart() -> None:
    joining = Joining("w0", 0.0)
    joining.take("", welcome())
    assert joining.take("", welcome(incarnation=2)) == Joined(False, True, False, incarnation=2)
    assert joining.take("", welcome(realm="s")) == Joined(True, True, False)
    assert joining.take("", welcome(realm="r")) == Joined(False, True, False)
    assert joining.realm == "r"


def test_absence_counts_from_the_start_or_the_loss_until_the_welcome() -> None:
    joining = Joining("w0", 5.0)
    assert joining.absence(8.0) == 3.0
    joining.take("", welcome())
    assert joining.absence(100.0) == 0.0
    joining.lost(100.0)
    assert joining.absence(103.0) == 3.0


def test_a_refusal_is_said_in_the_coordinators_words() -> None:
    body = Refusal(protocol=9, version="9", engine=9, sentence="too old, take 9")
    with pytest.raises(RefusedError, match="too old, take 9"):
        Joining("w0", 0.0).take("", encode(GreetingAnswer(body=body)))


def test_an_answer_that_is_not_understood_names_our_version() -> None:
    with pytest.raises(RefusedError, match=rf"Atoll {VERSION} \(protocol {PROTOCOL_VERSION}\)"):
        Joining("w0", 0.0).take("", b"\x00")
