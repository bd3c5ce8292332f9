"""XPPAUT: an .ode file, for phase planes and for AUTO's continuation."""

import re
from typing import Final

from atoll.export.content import Content, Language, Wording, refuse_regression, refuse_tables
from atoll.export.naming import Naming
from atoll_core.errors import UsageError
from atoll_core.expression.text.notation import XPPAUT

_WORDS: Final = (
    "sin cos tan atan atan2 sinh cosh tanh exp ln log log10 delay asin acos heav sign ceil flr ran abs max min "
    "normal besselj bessely besseli erf erfc arg poisson lgamma hom_bcs sqrt mod not if then else sum of shift "
    "del_shft int t pi i j e par param number init table wiener markov global aux bndry bdry done set volterra "
    "option options special solve only export vector block order x0 arg1 arg2 arg3 arg4 arg5 arg6 arg7 arg8 arg9 "
    "ishift isdel rate arg10 arg11 arg12 arg13 arg14 arg15 arg16 arg17 arg18 arg19 arg20 mouse_x mouse_y mouse_vx "
    "mouse_vy nxxqq"
)
_LONGEST: Final = 900
"""Characters of a line: XPPAUT reads 1024."""

LANGUAGE: Final = Language(
    XPPAUT,
    Naming(frozenset(_WORDS.split()), longest=9, is_caseless=True),
    "t",
    "#",
    "it ends the integration",
    "Open with: xppaut model.ode. AUTO (File, Auto) continues fixed points and cycles. XPPAUT keeps seven digits "
    "of what it shows.",
)


def write(content: Content) -> str:
    """Return an .ode file.

    Raises:
        UsageError: of a regression, of a table of an input and of an expression that is too long.
    """
    refuse_regression(content, "XPPAUT")
    refuse_tables(content, "XPPAUT")
    words = Wording(content, LANGUAGE)
    lines = [*words.heading(), ""]
    lines += [f"par {words[each]}={each.value!r}" for each in content.constants]
    lines += [f"par {words[each.name]}={each.value!r}" for each in content.held]
    pairs = zip(words.states, content.start, strict=True)
    lines += [f"init {name}={begin!r}" for name, begin in pairs]
    rates = words.rates
    if content.covariance:
        assignments, rows = words.noise
        drawn = words.normals
        lines += [f"wiener {name}" for name in drawn]
        lines += [f"{name}={text}" for name, text in assignments]
        rates = [
            " + ".join([rate, *(f"{g}*{w}" for g, w in zip(row, drawn, strict=True) if g)])
            for rate, row in zip(rates, rows, strict=True)
        ]
    lines += [f"{name}'={text}" for name, text in zip(words.states, rates, strict=True)]
    lines += [*_settings(content), "done"]
    for line in lines:
        if len(line) > _LONGEST:
            name = re.split("[='(]", line)[0]
            raise UsageError(
                f"the equation of {name} has {len(line)} characters, XPPAUT reads {_LONGEST}; use another format"
            )
    return "\n".join(lines) + "\n"


def _settings(content: Content) -> list[str]:
    step = (content.end - content.begin) / content.steps
    span = f"@ t0={content.begin!r}, total={content.end - content.begin!r}"
    size = f"@ maxstor={max(5000, content.steps + 2)}, bounds=1e10"
    if content.covariance:
        return [f"{span}, dt={step / 100!r}, njmp=100, meth=euler", size]
    least = 1e-12 * min(content.sizes)  # one for all states
    return [f"{span}, dt={step!r}, meth=83dp, tol=1e-12, atol={least!r}", size]
