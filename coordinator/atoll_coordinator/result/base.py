"""The base of all parts of a result: types of values, and a frozen model that keeps unknown keys."""

import math
from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, Strict
from pydantic_core import PydanticCustomError

from atoll_core.quoting import shown

Text = Annotated[str, Strict()]
Flag = Annotated[bool, Strict()]
Count = Annotated[int, Strict()]
Real = Annotated[float, Strict()]


def _check_positive(value: object) -> object:
    if isinstance(value, int | float) and not isinstance(value, bool) and 0.0 < value < math.inf:
        return value
    raise PydanticCustomError("positive", "a number above 0 is expected")


Positive = Annotated[Real, BeforeValidator(_check_positive), Field(gt=0.0)]


def finite(value: Any) -> Any:
    """Return None for a number that is not finite; other values are returned unchanged."""
    return (float(value) if math.isfinite(value) else None) if isinstance(value, float) else value


Number = Annotated[Real | None, BeforeValidator(finite)]
"""A number; null if it is unknown or not finite."""
Pair = tuple[Number, Number]
"""Lower and upper end of a range, null on an open side."""
Curve = tuple[Real | None, ...]
Curves = dict[Text, Curve]
"""Curves by name, each with one number for each of the times in the same part."""
Numbers = dict[Text, Number]
"""Numbers by name."""


class Part(BaseModel):
    """A part of a result; keys that this version does not know are kept, and written again."""

    model_config: ClassVar[ConfigDict] = ConfigDict(frozen=True, extra="allow", populate_by_name=True, defer_build=True)

    def replaced(self, **changes: object) -> Self:
        """Return a part with the fields `changes` replaced; the new values are checked as in a new part."""
        return type(self)(**{**dict(self), **changes})

    def __repr_args__(self) -> Iterator[tuple[str | None, Any]]:
        """Yield the fields for ``repr`` that are not empty; values are shortened, since curves have thousands of
        numbers.
        """
        for name, value in super().__repr_args__():
            if value is not None and value != () and value != {}:
                yield name, _Short(shown(value))


class _Short(str):
    """A text that ``repr`` shows without quotes, in place of a value."""

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)


def inconsistent(sentence: str) -> PydanticCustomError:
    """Return the error for values that have valid types but contradict each other."""
    return PydanticCustomError("inconsistent", "{sentence}", {"sentence": sentence})
