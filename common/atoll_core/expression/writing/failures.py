"""Rewritings that fail in a way that nobody thought of: contained, counted, and logged once of each kind."""

import logging
from collections import Counter
from collections.abc import Callable
from functools import wraps
from typing import Final, ParamSpec, TypeVar

from atoll_core.expression.writing.sums_of_products import UndefinedError

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")
FAILURES: Final[Counter[str]] = Counter()
"""How often rewriting failed, by function and kind of error."""


def contained(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Make any mistake in rewriting an `UndefinedError`, which leaves an expression as it was.

    Writing decides how an equation is shown, and not what it is: no mistake in it may cost an island or a job. What
    fails, fails at the same program always, so that the same seed still gives the same bits.
    """

    @wraps(function)
    def guarded(*arguments: Arguments.args, **named: Arguments.kwargs) -> Result:
        try:
            return function(*arguments, **named)
        except UndefinedError:
            raise
        except Exception as error:
            kind = f"{function.__name__}: {type(error).__name__}"
            FAILURES[kind] += 1
            if FAILURES[kind] == 1:
                logging.getLogger(__name__).warning("an expression stays as it was, rewriting failed: %s", kind)
            raise UndefinedError from error

    return guarded
