"""A model in a notebook: equations, verdicts and a table of constants as HTML."""

from html import escape
from typing import TYPE_CHECKING

from atoll.display.notation import CONSTANT_HEADS, constant_cells, mathml

if TYPE_CHECKING:
    from atoll.model.model import Model


def html(model: "Model") -> str:
    """Return equations, verdicts and a table of constants for a notebook."""
    parts = [mathml(model)]
    if model.remark:
        parts.append(f"<p>{escape(model.remark)}</p>")
    for equation in model.equations:
        if equation.verdict is not None:
            head, reason = f"{equation.lhs}: {equation.verdict}", equation.reason or ""
            parts.append(f"<p><b>{escape(head)}.</b> {escape(reason)}</p>")
    if model.params:
        rows = [
            _row("th", CONSTANT_HEADS),
            *(_row("td", constant_cells(constant)) for constant in model.params.values()),
        ]
        parts.append(f"<table>{''.join(rows)}</table>")
    return "<div>" + "".join(parts) + "</div>"


def _row(kind: str, cells: tuple[str, ...]) -> str:
    return "<tr>" + "".join(f"<{kind}>{escape(cell)}</{kind}>" for cell in cells) + "</tr>"
