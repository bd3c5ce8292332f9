"""What is said of a constant: its value, its standard error, what keeps both from being taken as they are."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from atoll.model.parameters import interval_text
from atoll_coordinator.result.equations import Constant

_EXACT_SHARE: Final = 1e-6
"""Standard errors below this share of their constants are those of rounding, and not worth a line."""


@dataclass(frozen=True)
class ConstantWords:
    """A constant as people are shown it: a number, such as ``2.981 ± 0.018``, `notes` on it, and its `unit`.

    `unit` is "1" of a pure number, None where units do not tell.
    """

    number: str
    notes: tuple[str, ...]
    unit: str | None


def plus_minus(value: float, error: float) -> str:
    """Return ``2.981 ± 0.018``, or ``1.21e-07 ± 3.0e-09``: an error in two digits, the value with as many decimals."""
    if not error > 0.0:
        return f"{value:.6g}"
    size = math.floor(math.log10(max(abs(value), error)))
    decimals = 1 - math.floor(math.log10(error))
    if -4 <= size < 6:
        return f"{value:.{max(decimals, 0)}f} ± {error:.{max(decimals, 0)}f}"
    return f"{value:.{max(decimals + size, 0)}e} ± {error:.1e}"


def number_text(value: float | None, digits: int = 3) -> str:
    """Return a number with so many significant digits; ``?`` for None."""
    return "?" if value is None else f"{value:.{digits}g}"


def with_errors(constants: Sequence[Constant]) -> list[Constant]:
    """Return those whose errors are known; where one is infinite, it is null, and nothing is determined."""
    return [each for each in constants if each.std_error is not None or not each.identifiable or each.at_bound]


def constant_words(constants: Sequence[Constant]) -> list[ConstantWords]:
    """Return what is said of the constants of an equation; nothing where no error is known, or all are rounding."""
    known = with_errors(constants)
    return [] if all(map(_is_exact, known)) else [*map(words_of, known)]


def _is_exact(constant: Constant) -> bool:
    is_small = (constant.std_error or 0.0) <= _EXACT_SHARE * abs(constant.value or 0.0)
    return is_small and constant.identifiable and not constant.at_bound


def words_of(constant: Constant) -> ConstantWords:
    """Return what is said of a constant: where it is shown rounded, what was fitted is a note."""
    shown, fitted = number_text(constant.value, 6), fitted_text(constant)
    notes = [] if constant.identifiable else ["not determined"]
    if constant.at_bound:
        notes = ["at its bound", interval_text(constant.interval)]
    elif constant.std_error is not None:
        begins_alike = fitted.startswith(f"{shown} ")
        shown, notes = (fitted, notes) if begins_alike else (shown, [fitted, *notes])
    return ConstantWords(shown, tuple(notes), constant.unit)


def fitted_text(constant: Constant) -> str:
    """Return the fitted value with its standard error."""
    return plus_minus(constant.estimate, constant.std_error or 0.0)
