"""The table of export formats, and three formats for text: LaTeX, SymPy source, and CSV of the fronts.

These three are written from a result, which may be incomplete: equations that were not found are left out.
"""

import csv
import io
import re
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Final

from atoll.export.description import Description, HeldInputs, Times, describe
from atoll.export.language import Language
from atoll.export.languages import JULIA, MATLAB, MODELICA, PYTHON, XPPAUT, C
from atoll.export.sbml import SBML
from atoll.model.arguments import Given
from atoll.model.equations import (
    ConstantWords,
    GivenWords,
    constant_words,
    displayed_equation,
    given_words,
    remark_on_groups,
    words_of_run,
)
from atoll.model.given_sides import fitted_parameters, named_side, searched_parts, with_parameter_names
from atoll_coordinator.result.equations import Equation, Observation
from atoll_coordinator.result.result import Result
from atoll_core.errors import UsageError
from atoll_core.expression.text.export import left_side_to_latex, to_latex, unit_to_latex
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.names import name_to_latex
from atoll_core.quoting import enumerated

if TYPE_CHECKING:
    from atoll.model.core import ModelCore

_COLUMNS: Final[tuple[str, ...]] = (
    "variable", "lhs", "pick", "selected", "shown", "origin", "complexity", "error", "normalized_error", "r2",
    "holdout_error", "expression",
)  # fmt: skip

_POWER: Final = re.compile(r"e([+-]?\d+)\b")
_DIGITS_AND_SIGN: Final = "-0123456789"


def as_csv(result: Result) -> str:
    """Return the equations as CSV with a header: each displayed equation, followed by all members of its front."""
    stream = io.StringIO()
    writer: csv.DictWriter[str] = csv.DictWriter(stream, _COLUMNS, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    parts = searched_parts(result)
    for equation in result.equations:
        sides = {"variable": equation.variable, "lhs": equation.lhs}
        origin = "known" if equation.why == "known" else "front"
        if equation.expression is not None:
            writer.writerow({**dict(equation), "shown": True})
        if equation.variable in parts:
            sides["lhs"] = f"{parts[equation.variable]} in {equation.lhs}"
        for number, member in enumerate(equation.front):
            writer.writerow({**dict(member), **sides, "pick": number, "shown": False, "origin": origin})
    return stream.getvalue().rstrip("\n")


def as_sympy(result: Result) -> str:
    """Return Python source with the symbols and a dictionary ``equations`` from left-hand side to expression.

    Parameters of given sides are symbols too; a dictionary ``parameters`` has their values.
    """
    parameters = {name: constant.value for name, constant in fitted_parameters(result).items()}
    names = (*result.names, *parameters)
    remark = remark_on_groups(result)
    lines = [f"# {remark}"] if remark else []
    lines += ["import sympy", "", f"names = {[*names]!r}", "symbols = {name: sympy.Symbol(name) for name in names}"]
    lines += ["equations = {"]
    for equation in result.equations:
        if equation.expression is not None:
            expression = to_infix(*with_parameter_names(equation, result.names)) if parameters else equation.expression
            parsed = f"sympy.parse_expr({expression!r}, local_dict=symbols)"
            lines.append(f"    {equation.lhs!r}: {parsed},")
    lines.append("}")
    if result.observations:
        texts = {one.column: to_infix(*with_parameter_names(one, result.names)) for one in result.observations}
        parsed = ", ".join(f"{name!r}: sympy.parse_expr({text!r}, local_dict=symbols)" for name, text in texts.items())
        lines.append(f"observations = {{{parsed}}}  # measured columns that are computed from states")
    if parameters:
        values = ", ".join(f"symbols[{name!r}]: {value!r}" for name, value in parameters.items())
        lines.append(f"parameters = {{{values}}}  # equations[...].subs(parameters)")
    return "\n".join(lines)


def as_latex(result: Result) -> str:
    """Return an ``align*`` environment with one line for each equation."""
    lines = [f"  {line}" for line in latex_lines(result)]
    remark = remark_on_groups(result)
    begin = [*([f"% {remark}"] if remark else []), r"\begin{align*}"]
    return "\n".join([*begin, *([" \\\\\n".join(lines)] if lines else []), r"\end{align*}"])


def latex_lines(result: Result) -> list[str]:
    """Return each equation as a line of an aligned environment, with its unit and, in the next line, its constants."""
    names, lines = result.names, []
    for equation in result.equations:
        if equation.expression is None:
            continue
        if equation.runs:
            values = ",\\; ".join(_constant_latex(words_of_run(one)) for one in equation.runs)
            lines.append(rf"{left_side_to_latex(equation.variable, is_name=True)} &= {values} \quad \text{{by run}}")
            continue
        left = left_side_to_latex(equation.lhs, is_name=equation.lhs == equation.variable)
        unit = displayed_equation(result, equation).unit
        unit = rf" \quad \left[{unit_to_latex(unit)}\right]" if unit else ""
        given = given_words(equation, names)
        lines += [f"{left} &= {_side_latex(equation, names)}{unit}", *_parameters_latex(given)]
        constants = ",\\; ".join(map(_constant_latex, constant_words(given.constants)))
        lines += [rf"&\quad \text{{constants: }} {constants}"] if constants else []
    for one in result.observations:
        left = left_side_to_latex(one.column, is_name=True)
        lines += [f"{left} &= {_side_latex(one, names)}", *_parameters_latex(given_words(one, names))]
    return lines


def _parameters_latex(given: GivenWords) -> list[str]:
    """Return a line with the values of the parameters of a given side; no line without parameters."""
    pairs = given.parameters.items()
    values = ",\\; ".join(f"{name_to_latex(name)} = {_constant_latex(words)}" for name, words in pairs)
    return [rf"&\quad {values}"] if values else []


def _side_latex(equation: Equation | Observation, names: Sequence[str]) -> str:
    """Return a right-hand side; a given side has its parameters by name, and a brace below its unknown parts."""
    program, known, parts, is_given = named_side(equation, names)
    return to_latex(program, known, is_given=is_given, parts=parts)


def _constant_latex(words: ConstantWords) -> str:
    """Return ``19.92\\; (19.9 \\pm 1.7)\\,\\mathrm{m}``."""
    notes = ", ".join(
        _numbers_latex(note) if note[0] in _DIGITS_AND_SIGN else rf"\text{{{note}}}" for note in words.notes
    )
    unit = rf"\,{unit_to_latex(words.unit)}" if words.unit not in (None, "1") else ""
    return _numbers_latex(words.number) + (rf"\; ({notes})" if notes else "") + unit


def _numbers_latex(text: str) -> str:
    text = _POWER.sub(lambda power: rf" \cdot 10^{{{int(power[1])}}}", text)
    return text.replace("±", r"\pm").replace(" to ", r"\text{ to }")


LANGUAGES: Final[Mapping[str, Language]] = {
    "python": PYTHON,
    "c": C,
    "julia": JULIA,
    "matlab": MATLAB,
    "modelica": MODELICA,
    "xppaut": XPPAUT,
    "sbml": SBML,
}
RESULT_FORMATS: Final[Mapping[str, Callable[[Result], str]]] = {
    "latex": as_latex,
    "sympy": as_sympy,
    "csv": as_csv,
    "json": Result.to_json,
}
PETAB: Final = "petab"
"""The format of a folder, written by `atoll.export.petab`."""
NAMES: Final = (*LANGUAGES, *RESULT_FORMATS, PETAB)


def export_model(model: "ModelCore", name: str, x0: Given | None = None, t: Times = None, u: HeldInputs = None) -> str:
    """Return the model in the format `name`, which is a single file; see `atoll.Model.export`."""
    if name in RESULT_FORMATS:
        return RESULT_FORMATS[name](model.result)
    if name not in LANGUAGES:
        known = ", ".join([*LANGUAGES, *RESULT_FORMATS])
        raise UsageError(f"{name!r} is not an export format; choose one of {known}, or petab with a folder")
    return write(describe(model, x0, t, u, LANGUAGES[name].without_tables), LANGUAGES[name])


def write(model: Description, language: Language) -> str:
    """Return the file of a language; raises UsageError if the language cannot express the model."""
    require_support(model, language)
    return language.write(model)


def require_support(model: Description, language: Language) -> None:
    """Raise UsageError if a format lacks noise for a process, functions for a regression, or tables of inputs."""
    if model.covariance and not language.has_noise:
        able = enumerated([name for name, other in LANGUAGES.items() if other.has_noise])
        raise UsageError(f"{language.name} cannot express the noise of a process; {able} can")
    if not model.states and not language.regression:
        able = ", ".join([name for name, other in LANGUAGES.items() if other.regression])
        raise UsageError(
            f"{language.name} only expresses models of dynamics, but this is a regression; use {able}, latex or sympy"
        )
    if model.tables and not language.has_tables:
        raise UsageError(
            f"{language.name} has no tables, but the input '{model.tables[0].name}' changes; give one number for it"
        )
