"""How a language writes expressions, beside the table of operators.

A notation says how functions are called and how powers are written; the rest, + - * / with brackets, is the same in all
languages. `INFIX` is that of Atoll's own expressions, which our parser and sympy read; those of other languages stand
with the rest of their words (`atoll.export`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from atoll_core.expression.operators import FUNCTIONS
from atoll_core.expression.text.form import COTANGENT, TANGENT


@dataclass(frozen=True)
class Notation:
    """How one language writes what operators do.

    `functions` are names by operator code, where they differ from ours, and `prefix` stands before those that do not.
    `power` writes a base and an exponent, `natural` a base and a natural number. A power `is_call` where that is a
    function call, whose arguments need no brackets. `tangent` and `cotangent` name the quotients of sine and cosine;
    empty: there is no such function, and the quotient is written.
    """

    functions: Mapping[int, str] = field(default_factory=dict)
    prefix: str = ""
    power: str = "{0}^{1}"
    natural: str = "{0}^{1}"
    is_call: bool = False
    tangent: str = "tan"
    cotangent: str = ""

    def call(self, code: int) -> str:
        """Return the name of the function of an operator, or of a quotient of sine and cosine."""
        return self.functions.get(code) or self.prefix + (self._names.get(code) or FUNCTIONS[code])

    @property
    def _names(self) -> dict[int, str]:
        return {TANGENT: self.tangent, COTANGENT: self.cotangent}

    @property
    def quotients(self) -> frozenset[int]:
        """The codes of the quotients of sine and cosine that have a name."""
        return frozenset(code for code in (TANGENT, COTANGENT) if self._names[code])


INFIX: Final = Notation(power="{0}**{1}", natural="{0}**{1}", cotangent="cot")
