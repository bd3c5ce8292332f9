"""A call that waits has a limit."""

import threading

import pytest

from atoll.workers.limited import limited
from atoll_core.errors import UnreachableError


def test_what_a_call_returns_or_raises_comes_through() -> None:
    assert limited(lambda: 3, 60.0, "it has not answered") == 3
    assert limited(lambda: None, 60.0, "it has not answered") is None
    with pytest.raises(ZeroDivisionError):
        limited(lambda: 1 // 0, 60.0, "it has not answered")


def test_a_call_that_takes_longer_is_left() -> None:
    end = threading.Event()
    with pytest.raises(UnreachableError, match=r"it has not answered within 0.01 s; a machine of it may hang"):
        limited(end.wait, 0.01, "it has not answered")
    end.set()
