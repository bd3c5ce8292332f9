"""Call one of several compiled functions, chosen by a code. Kernels call the function of an operator in this way."""

from collections.abc import Callable
from typing import Any

from atoll_core.compilation.jit import inlined


def choose(branches: dict[int, Callable[..., Any]], otherwise: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of a code and further arguments, which calls the branch of this code with these arguments.

    For other codes it calls `otherwise` with the code and the arguments. All functions must be callable from compiled
    code and return the same type. The choice is one function with 15 branches, one for each operator. A chain of
    smaller functions would take longer to compile, since each function is compiled again in its caller.
    """
    pairs = list(branches.items())
    pairs += [(-1, pairs[0][1])] * (15 - len(pairs))
    codes, functions = zip(*pairs, strict=True)
    c0, c1, c2, c3, c4, c5, c6, c7, c8, c9, c10, c11, c12, c13, c14 = codes
    f0, f1, f2, f3, f4, f5, f6, f7, f8, f9, f10, f11, f12, f13, f14 = functions

    @inlined
    def chosen(code: int, *arguments: Any) -> Any:
        if code == c0:
            return f0(*arguments)
        if code == c1:
            return f1(*arguments)
        if code == c2:
            return f2(*arguments)
        if code == c3:
            return f3(*arguments)
        if code == c4:
            return f4(*arguments)
        if code == c5:
            return f5(*arguments)
        if code == c6:
            return f6(*arguments)
        if code == c7:
            return f7(*arguments)
        if code == c8:
            return f8(*arguments)
        if code == c9:
            return f9(*arguments)
        if code == c10:
            return f10(*arguments)
        if code == c11:
            return f11(*arguments)
        if code == c12:
            return f12(*arguments)
        if code == c13:
            return f13(*arguments)
        if code == c14:
            return f14(*arguments)
        return otherwise(code, *arguments)

    return chosen


@inlined
def nothing(code: int, *arguments: Any) -> None:
    """Do nothing; used as `otherwise` for codes that do not occur."""
