"""What the parts of a result share: kinds of values, and that nothing changes after it was read."""

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


def _positive(value: object) -> object:
    if isinstance(value, int | float) and not isinstance(value, bool) and 0.0 < value < math.inf:
        return value
    raise PydanticCustomError("positive", "a number above 0 is expected")


Positive = Annotated[Real, BeforeValidator(_positive), Field(gt=0.0)]


def finite(value: Any) -> Any:
    """Return a value as a result holds it: None where it is a number that is not finite."""
    return (float(value) if math.isfinite(value) else None) if isinstance(value, float) else value


Number = Annotated[Real | None, BeforeValidator(finite)]
"""A number, null where it is not known or not finite."""
Pair = tuple[Number, Number]
"""Lower and upper end of a range, null on an open side."""
Curve = tuple[Real | None, ...]
Curves = dict[Text, Curve]
"""Curves by name, each with one number for each of the times in the same part."""
Numbers = dict[Text, Number]
"""By name."""


class Part(BaseModel):
    """A part of a result; a key that this version does not know is kept, and written again."""

    model_config: ClassVar[ConfigDict] = ConfigDict(frozen=True, extra="allow", populate_by_name=True, defer_build=True)

    def replaced(self, **changes: object) -> Self:
        """Return a part with other values of some fields, checked like the values of a new one."""
        return type(self)(**{**dict(self), **changes})

    def __repr_args__(self) -> Iterator[tuple[str | None, Any]]:
        """Yield what ``repr`` shows: what there is, each on a short line, since curves have thousands of numbers."""
        for name, value in super().__repr_args__():
            if value is not None and value != () and value != {}:
                yield name, _Short(shown(value))


class _Short(str):
    """A text that stands for a value."""

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)


def misfit(sentence: str) -> PydanticCustomError:
    """Return the error of values that are of their kinds and do not fit together."""
    return PydanticCustomError("misfit", "{sentence}", {"sentence": sentence})
