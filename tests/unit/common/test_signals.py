"""How programs meet signals that whoever started them has them ignore."""

import signal
import threading
from collections.abc import Iterator

import pytest

from atoll_core.signals import interrupts_held_back, raising_interrupts, stopping


@pytest.fixture
def _in_the_background() -> Iterator[None]:
    """Ignore Ctrl-C as a command that a script starts with ``&`` does, and hang-ups as ``nohup`` has it."""
    before = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGINT, signal.SIGHUP)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("_in_the_background")
def test_a_hang_up_that_is_ignored_stays_ignored() -> None:
    stop = threading.Event()
    with raising_interrupts():
        signal.raise_signal(signal.SIGHUP)
    with stopping(stop):
        signal.raise_signal(signal.SIGHUP)
    assert not stop.is_set()


@pytest.mark.usefixtures("_in_the_background")
def test_an_interrupt_that_somebody_sends_counts_also_in_the_background() -> None:
    with pytest.raises(KeyboardInterrupt), raising_interrupts():
        signal.raise_signal(signal.SIGINT)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_without_that_all_of_them_end_a_program_alike(number: signal.Signals) -> None:
    stop = threading.Event()
    with stopping(stop):
        signal.raise_signal(number)
    assert stop.is_set()
    with pytest.raises(KeyboardInterrupt), raising_interrupts():
        signal.raise_signal(number)


def test_an_interrupt_during_foreign_code_is_raised_behind_it() -> None:
    """Zenoh's binding prints what is raised in a callback, and goes on: an interrupt there was lost."""
    done: list[str] = []

    def interrupted() -> None:
        with interrupts_held_back():
            with interrupts_held_back():
                signal.raise_signal(signal.SIGTERM)
                done.append("inside")
            done.append("behind the inner one")

    with raising_interrupts():
        with pytest.raises(KeyboardInterrupt):
            interrupted()
        assert done == ["inside", "behind the inner one"]
        with interrupts_held_back():
            pass  # it is raised once
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
