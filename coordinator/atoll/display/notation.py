"""A model as people read it: text, LaTeX, MathML, HTML."""

import html as escaping
from collections.abc import Sequence
from typing import TYPE_CHECKING

from atoll.export.text import latex_lines
from atoll_core.expression.text.export import left_side_to_mathml, to_mathml
from atoll_core.expression.text.parsing import from_infix

if TYPE_CHECKING:
    import sympy

    from atoll.model.model import Model
    from atoll.model.parameters import Parameter

_MATH = '<math xmlns="http://www.w3.org/1998/Math/MathML" display="block">'
_HEADS = ("constant", "value", "standard error", "95 % interval", "equation of")


def summary(model: "Model") -> str:
    """Return equations with verdicts, constants with errors, and where the model comes from."""
    lines = []
    for each in model.equations:
        lines.append(str(each))
        if each.verdict is not None:
            lines.append(f"    {each.verdict}: {each.reason}")
    lines += filter(None, [model.remark])
    rows = [_HEADS, *map(_cells, model.params.values())]
    widths = [max(len(row[column]) for row in rows) for column in range(len(_HEADS))]
    if model.params:
        lines.append("")
    lines += ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows if model.params]
    its = model.provenance
    lines += ["", f"seed {its['seed']}, digest {its['digest']}"]
    if its["data"]:
        lines.append(f"data {', '.join(its['files'] or ())}: {its['rows']} rows, sha256 {its['data']}")
    if its["command"]:
        lines.append(f"command: {its['command']}")
    return "\n".join(lines)


def latex(model: "Model") -> str:
    """Return the equations in an ``aligned`` environment."""
    return r"\begin{aligned}" + r" \\ ".join(latex_lines(model.result)) + r"\end{aligned}"


def sympy_expressions(model: "Model") -> "dict[str, sympy.Expr]":
    """Return the right-hand sides as sympy expressions, by left-hand side."""
    from atoll_core.expression.text.export import to_sympy

    names = model.result.names
    return {equation.lhs: to_sympy(from_infix(equation.exact, names), names) for equation in model.equations}


def mathml(model: "Model") -> str:
    """Return the equations as the rows of a table in presentation MathML."""
    names = model.result.names
    rows = [
        "<mtr>"
        + "".join(f"<mtd>{cell}</mtd>" for cell in _mathml_parts(each.lhs, each.variable, each.expression, names))
        + "</mtr>"
        for each in model.equations
    ]
    return f"{_MATH}<mtable>{''.join(rows)}</mtable></math>"


def equation_mathml(lhs: str, variable: str, expression: str, names: Sequence[str]) -> str:
    """Return one equation as MathML (presentation); `expression` is its right-hand side over `names`.

    A left-hand side that is the `variable` itself is a name, even where it reads like a derivative.
    """
    return f"{_MATH}<mrow>{''.join(_mathml_parts(lhs, variable, expression, names))}</mrow></math>"


def _mathml_parts(lhs: str, variable: str, expression: str, names: Sequence[str]) -> tuple[str, str, str]:
    side = left_side_to_mathml(lhs, is_name=lhs == variable)
    return side, "<mo>=</mo>", to_mathml(from_infix(expression, names), names)


def html(model: "Model") -> str:
    """Return equations, verdicts and a table of constants for a notebook."""
    parts = [mathml(model)]
    if model.remark:
        parts.append(f"<p>{escaping.escape(model.remark)}</p>")
    verdicts = [each for each in model.equations if each.verdict is not None]
    parts += [
        f"<p><b>{escaping.escape(f'{each.lhs}: {each.verdict}')}.</b> {escaping.escape(each.reason or '')}</p>"
        for each in verdicts
    ]
    if model.params:
        rows = [_row("th", _HEADS), *(_row("td", _cells(each)) for each in model.params.values())]
        parts.append(f"<table>{''.join(rows)}</table>")
    return "<div>" + "".join(parts) + "</div>"


def _row(kind: str, cells: tuple[str, ...]) -> str:
    return "<tr>" + "".join(f"<{kind}>{escaping.escape(cell)}</{kind}>" for cell in cells) + "</tr>"


def _cells(its: "Parameter") -> tuple[str, ...]:
    between = "?" if its.interval is None else _between(its.value, *its.interval)
    error = "?" if its.stderr is None else f"{its.stderr:.2g}"
    unit = f" {its.unit}" if its.unit not in (None, "1") else ""
    return its.name, f"{its.value:.6g}{unit}", error, between, its.variable


def _between(value: float, low: float, high: float) -> str:
    """Return ``± half`` of an interval around `value`, else, as of a constant on its bound, ``low to high``."""
    half = 0.5 * (high - low)
    if abs(0.5 * (low + high) - value) > 0.05 * half:  # more than the two digits of the half show
        return f"{low:.4g} to {high:.4g}"
    return f"± {half:.2g}"
