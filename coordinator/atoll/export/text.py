"""A result as text for people and sympy: LaTeX, Python that makes sympy objects, CSV of the fronts.

Equations that were not found are left out.
"""

import csv
import io
from typing import Final

from atoll.model.groups import remark_on_groups
from atoll_coordinator.result.result import Result
from atoll_core.expression.text.export import left_side_to_latex, to_latex
from atoll_core.expression.text.parsing import from_infix

_COLUMNS: Final[tuple[str, ...]] = (
    "variable", "lhs", "pick", "selected", "shown", "origin", "complexity", "error", "normalized_error", "r2",
    "holdout_error", "expression",
)  # fmt: skip


def as_csv(result: Result) -> str:
    """Return the equations as CSV with a header: for each the one that is shown, then all members of its front."""
    stream = io.StringIO()
    writer: csv.DictWriter[str] = csv.DictWriter(stream, _COLUMNS, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    for equation in result.equations:
        sides = {"variable": equation.variable, "lhs": equation.lhs}
        origin = "known" if equation.why == "known" else "front"
        if equation.expression is not None:
            writer.writerow({**dict(equation), "shown": True})
        for number, member in enumerate(equation.front):
            writer.writerow({**dict(member), **sides, "pick": number, "shown": False, "origin": origin})
    return stream.getvalue().rstrip("\n")


def as_sympy(result: Result) -> str:
    """Return Python source that makes the symbols and a dictionary ``equations`` from left-hand side to expression."""
    names = result.names
    remark = remark_on_groups(result)
    lines = [f"# {remark}"] if remark else []
    lines += ["import sympy", "", f"names = {[*names]!r}", "symbols = {name: sympy.Symbol(name) for name in names}"]
    lines += ["equations = {"]
    for equation in result.equations:
        if equation.expression is not None:
            parsed = f"sympy.parse_expr({equation.expression!r}, local_dict=symbols)"
            lines.append(f"    {equation.lhs!r}: {parsed},")
    return "\n".join([*lines, "}"])


def as_latex(result: Result) -> str:
    """Return an ``align*`` environment with one line for each equation."""
    lines = [f"  {line}" for line in latex_lines(result)]
    remark = remark_on_groups(result)
    begin = [*([f"% {remark}"] if remark else []), r"\begin{align*}"]
    return "\n".join([*begin, *([" \\\\\n".join(lines)] if lines else []), r"\end{align*}"])


def latex_lines(result: Result) -> list[str]:
    """Return each equation as a line of an aligned environment."""
    names = result.names
    return [
        f"{left_side_to_latex(equation.lhs, is_name=equation.lhs == equation.variable)} &= "
        f"{to_latex(from_infix(equation.expression, names), names)}"
        for equation in result.equations
        if equation.expression is not None
    ]
