"""A call into a cluster's client library, which waits for as long as the cluster is silent, within a limit."""

import threading
from collections.abc import Callable
from typing import TypeVar

from atoll_core.errors import UnreachableError

A = TypeVar("A")


def limited(call: Callable[[], A], limit_s: float, what: str) -> A:
    """Return what `call` does, or raise what it raises; UnreachableError with `what` when it takes longer.

    Then its thread goes on waiting, and ends with this process at the latest.
    """
    answers: list[A] = []
    errors: list[BaseException] = []

    def act() -> None:
        try:
            answers.append(call())
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=act, name=f"waiting: {what}", daemon=True)
    thread.start()
    thread.join(limit_s)
    if errors:
        raise errors[0]
    if not answers:
        raise UnreachableError(f"{what} within {limit_s:g} s; a machine of it may hang: see its logs")
    return answers[0]
