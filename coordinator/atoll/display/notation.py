"""Write a model as text, LaTeX, SymPy, MathML and HTML."""

from collections.abc import Iterable, Sequence
from html import escape
from importlib.util import find_spec
from typing import TYPE_CHECKING, Final

from atoll.export.formats import latex_lines
from atoll.model.equations import observation_text, unit_text
from atoll.model.given_sides import named_side
from atoll.terminal.output import table
from atoll_coordinator.result.equations import Equation
from atoll_core.errors import UsageError
from atoll_core.expression.text.export import left_side_to_mathml, to_mathml
from atoll_core.expression.text.parsing import from_infix
from atoll_core.redaction import without_secrets

if TYPE_CHECKING:
    import sympy

    from atoll.model.core import ModelCore
    from atoll.model.equations import Parameter

_MATH: Final = '<math xmlns="http://www.w3.org/1998/Math/MathML" display="block">'
_HEADS: Final = ("constant", "value", "standard error", "95 % interval", "equation of")


def summary(model: "ModelCore") -> str:
    """Return equations with verdicts, constants with errors, and the origin of the model."""
    lines = []
    for equation in model.equations:
        lines.append(str(equation))
        if equation.verdict is not None:
            lines.append(f"    {equation.verdict}: {equation.reason}")
    lines += [observation_text(one, model.result.names) for one in model.result.observations]
    lines += filter(None, [model.remark])
    if model.params:
        lines += ["", table(_HEADS, map(_cells, model.params.values()))]
    result, data = model.result, model.result.data
    lines += ["", f"seed {result.seed}, digest {result.digest}"]
    if data is not None and data.digest:
        lines.append(f"data {', '.join(data.files)}: {data.rows} rows, sha256 {data.digest}")
    if result.command:
        lines.append(f"command: {without_secrets(result.command)}")
    return "\n".join(lines)


def latex(model: "ModelCore") -> str:
    """Return the equations in an ``aligned`` environment."""
    return r"\begin{aligned}" + r" \\ ".join(latex_lines(model.result)) + r"\end{aligned}"


def sympy_expressions(model: "ModelCore") -> "dict[str, sympy.Expr]":
    """Return the right-hand sides as sympy expressions, by left-hand side; raises UsageError without sympy."""
    from atoll_core.expression.text.export import to_sympy

    if find_spec("sympy") is None:
        raise UsageError("expressions of sympy need sympy, which is not installed; run: pip install 'atoll[sympy]'")
    names = model.result.names
    return {equation.lhs: to_sympy(from_infix(equation.exact, names), names) for equation in model.equations}


def mathml(model: "ModelCore") -> str:
    """Return the equations as the rows of a table in presentation MathML."""
    parts = [_mathml_parts(equation, model.result.names) for equation in model.result.equations]
    rows = (_row("mtr", "mtd", cells) for cells in parts)
    return f"{_MATH}<mtable>{''.join(rows)}</mtable></math>"


def html(model: "ModelCore") -> str:
    """Return equations, verdicts and a table of constants for a notebook."""
    parts = [mathml(model)]
    if model.remark:
        parts.append(f"<p>{escape(model.remark)}</p>")
    for equation in model.equations:
        if equation.verdict is not None:
            head, reason = f"{equation.lhs}: {equation.verdict}", equation.reason or ""
            parts.append(f"<p><b>{escape(head)}.</b> {escape(reason)}</p>")
    if model.params:
        rows = [_row("tr", "td", map(escape, _cells(constant))) for constant in model.params.values()]
        parts.append(f"<table>{_row('tr', 'th', _HEADS)}{''.join(rows)}</table>")
    return f"<div>{''.join(parts)}</div>"


def _row(row: str, cell: str, contents: Iterable[str]) -> str:
    return f"<{row}>{''.join(f'<{cell}>{content}</{cell}>' for content in contents)}</{row}>"


def equation_mathml(equation: Equation, names: Sequence[str]) -> str:
    """Return one equation over `names` as MathML (presentation).

    A left-hand side that is the variable itself is a name, even if it reads like a derivative. A side that the user
    gave has its parameters by name, and a brace below its unknown parts.
    """
    return f"{_MATH}<mrow>{''.join(_mathml_parts(equation, names))}</mrow></math>"


def _mathml_parts(equation: Equation, names: Sequence[str]) -> tuple[str, str, str]:
    left = left_side_to_mathml(equation.lhs, is_name=equation.lhs == equation.variable)
    program, known, parts, is_given = named_side(equation, names)
    return left, "<mo>=</mo>", to_mathml(program, known, is_given=is_given, parts=parts)


def _cells(constant: "Parameter") -> tuple[str, ...]:
    between = "?" if constant.interval is None else _interval_text(constant.value, *constant.interval)
    error = "?" if constant.stderr is None else f"{constant.stderr:.2g}"
    return constant.name, f"{constant.value:.6g}{unit_text(constant.unit)}", error, between, constant.variable


def _interval_text(value: float, low: float, high: float) -> str:
    """Return ``± half`` if `value` is the middle of the interval, otherwise ``low to high``, as at a bound."""
    half = 0.5 * (high - low)
    if abs(0.5 * (low + high) - value) > 0.05 * half:  # a larger difference than two digits show
        return f"{low:.4g} to {high:.4g}"
    return f"± {half:.2g}"
