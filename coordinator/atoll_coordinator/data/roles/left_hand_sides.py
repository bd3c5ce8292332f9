"""Left-hand sides as people write them, and the variables that they belong to. Pure.

The equation of ``x`` is called ``x``, ``dx``, ``dx/dt`` or ``x'``, for order 2 ``d2x``, ``d2x/dt2`` or ``x''``; columns
by their name or by their symbol. A column that is called ``dx`` itself comes before the derivative of ``x``.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

from atoll_coordinator.data.roles.column_options import split_unit
from atoll_core.errors import UsageError
from atoll_core.quoting import did_you_mean

Value = TypeVar("Value")

_FORMS: Final = {1: r"d{0}(/d\w+)?|{0}'", 2: r"d2{0}(/d\w+?(\^|\*\*)?2)?|{0}''"}
"""By order of the derivative, what is matched, {0} being the escaped name."""

_ORDINALS: Final = {1: "first", 2: "second"}


@dataclass(frozen=True)
class LeftSides:
    """The equations of a job: `variables` are their names, `order` that of the derivatives, None when there are none.

    `symbols` has the symbol of each column that expressions may use, in the order of the dataset's rows.
    """

    variables: tuple[str, ...]
    symbols: Mapping[str, str]
    order: int | None

    def several(self, option: str, by_side: Mapping[str, Value]) -> dict[str, tuple[Value, ...]]:
        """Return the values in `by_side` for each variable, in the order of the variables.

        Raises UsageError, naming `option`, where a left-hand side belongs to no variable.
        """
        pairs = [(self.variable(option, text), value) for text, value in by_side.items()]
        named = {name for name, _ in pairs}
        return {
            name: tuple(value for other, value in pairs if other == name) for name in self.variables if name in named
        }

    def single(self, option: str, by_side: Mapping[str, Value]) -> dict[str, Value]:
        """Return the value in `by_side` for each variable; raises UsageError like `several`, or for one named twice."""
        several = self.several(option, by_side)
        twice = next((name for name, values in several.items() if len(values) > 1), None)
        if twice is not None:
            raise UsageError(f"{option} names the equation of '{twice}' twice; give one")
        return {name: value for name, (value,) in several.items()}

    def variable(self, option: str, text: str) -> str:
        """Return the variable that the left-hand side `text` belongs to; raises UsageError, naming `option`."""
        text = text.strip()
        for name in (text, split_unit(text)[0]):
            if name in self.variables:
                return name
        named = [name for name in self.variables if self.symbols.get(name) == text]
        fitting = named or [name for name in self.variables if self._is_derivative(text, name, self.order)]
        if fitting:
            return fitting[0]
        for order in _FORMS:
            if any(self._is_derivative(text, name, order) for name in self.variables):
                raise UsageError(f"{option} names '{text}', a {_ORDINALS[order]} derivative, but {self._sought()}")
        sought = f"{', '.join(self.variables)}{did_you_mean(text, self.variables)}"
        raise UsageError(f"{option} names '{text}', but equations are sought for {sought}")

    def symbols_of(self, option: str, texts: Sequence[str]) -> tuple[str, ...]:
        """Return the symbols of variables named by column or symbol; raises UsageError, naming `option`."""
        if not texts:
            nothing = f"{option} names no variable for an equation"
            raise UsageError(f"{nothing}; name at least one of {', '.join(self.symbols)}")
        return tuple(dict.fromkeys(self._symbol(option, text) for text in texts))

    def _symbol(self, option: str, text: str) -> str:
        for name in (text, split_unit(text)[0]):
            if name in self.symbols:
                return self.symbols[name]
        if text in self.symbols.values():
            return text
        variables = f"{', '.join(self.symbols)}{did_you_mean(text, self.symbols)}"
        raise UsageError(f"{option} names '{text}', but the variables are {variables}")

    def _is_derivative(self, text: str, name: str, order: int | None) -> bool:
        if order is None:
            return False
        names = dict.fromkeys((name, self.symbols.get(name, name)))
        return any(re.fullmatch(_FORMS[order].format(re.escape(spelling)), text) for spelling in names)

    def _sought(self) -> str:
        if self.order is None:
            return f"{', '.join(self.variables)} is sought as it stands; name it so"
        other = "leave --order 2 out" if self.order == 2 else "add --order 2"
        return f"{_ORDINALS[self.order]} derivatives are sought; write d{'2' * (self.order == 2)}x=…, or {other}"
