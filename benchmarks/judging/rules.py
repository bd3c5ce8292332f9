"""The one answer to the question whether a found equation has the true form, whichever rule gives it.

A rule is a function of the text that was found: `benchmarks.judging.forms` fits the truth's constants, which are then
to be the truth's (`compare`) or any (`judge_form`), and `benchmarks.peers.srbench.assess` is SRBench's own. They need
not agree on what is nearly right, and each published figure names the rule that it is by.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

Kind = Literal["right", "near", "extra", "missing", "other", "none"]
"""The truth's form; the same with a constant beyond the tolerance; with needless terms; without some of its terms;
another form; no equation."""


@dataclass(frozen=True)
class Form:
    """How a found equation compares with the truth, and why.

    `extra` is how many summands are too many (None: not known). `constants_error` is the largest relative difference of
    a coefficient, None where the terms differ or the rule has no such thing; `function_error` the root mean square
    difference on fresh points in the data's range over the truth's standard deviation there, None where it is not
    finite; `r_squared` is that on the rows, by SRBench's rule alone.
    """

    kind: Kind
    extra: int | None = None
    reason: str = ""
    constants_error: float | None = None
    function_error: float | None = None
    r_squared: float | None = None

    @property
    def is_right(self) -> bool:
        """Whether it has the truth's form and nothing else, with constants within the tolerance if there is one."""
        return self.kind == "right"


NO_EQUATION: Final = Form("none", reason="no equation was found")

Rule = Callable[[str | None], Form]


def right_ones(rule: Rule, members: Iterable[Mapping[str, Any]]) -> Iterable[Mapping[str, Any]]:
    """Yield those equations of a front, or of candidates, in whose ``expression`` the form is right."""
    return (member for member in members if rule(member.get("expression")).is_right)
