"""The table of formats: what each is called, who opens it, and what writes it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from atoll.export import c, julia, matlab, modelica, python, sbml, text, xppaut
from atoll.export.content import Content, content_of
from atoll_coordinator.result.result import Result
from atoll_core.errors import UsageError

if TYPE_CHECKING:
    from atoll.model.model import Model


@dataclass(frozen=True)
class Format:
    """A format of one file: its `name` in options, what it `holds`, who `opens` it.

    Exactly one writer is given: `of_content` where a file has an initial state and times; `of_result` where it
    holds what a result has, which need not be a model. `without_tables` is the name of a program that cannot take
    inputs along tables, "" of others.
    """

    name: str
    holds: str
    opens: str
    of_content: Callable[[Content], str] | None = None
    of_result: Callable[[Result], str] | None = None
    without_tables: str = ""


FORMATS: Final = {
    each.name: each
    for each in (
        Format("python", "a module with its own integrator", "Python with numpy", python.write),
        Format("c", "a C99 program with its own integrator, CSV out", "any C compiler", c.write),
        Format("julia", "a ModelingToolkit system", "Julia: OrdinaryDiffEq, BifurcationKit, Attractors", julia.write),
        Format("matlab", "a function that calls ode45", "MATLAB, Octave", matlab.write),
        Format("modelica", "a model", "OpenModelica, Dymola; FMUs by them", modelica.write),
        Format("xppaut", "an .ode file", "XPPAUT and its AUTO", xppaut.write, without_tables="XPPAUT"),
        Format("sbml", "rate rules, L3V2", "COPASI, tellurium, AMICI, Julia's SBMLToolkit", sbml.write),
        Format("latex", "the equations, aligned", "LaTeX", None, text.as_latex),
        Format("sympy", "the equations as sympy objects", "Python with sympy", None, text.as_sympy),
        Format("csv", "the fronts, a row for each equation", "spreadsheets, pandas, R", None, text.as_csv),
        Format("json", "the whole result", "coordinator, atoll.Model", None, Result.to_json),
    )
}
"""By name. PEtab is a folder and has its own writer (`atoll.export.petab`)."""

PETAB: Final = "petab"
NAMES: Final = (*FORMATS, PETAB)


def format_of(name: str) -> Format:
    """Return a format of one file by its name; raises UsageError."""
    if name not in FORMATS:
        raise UsageError(
            f"{name!r} is no format of an export; choose one of {', '.join(FORMATS)}, or petab with a folder"
        )
    return FORMATS[name]


def written(model: "Model", name: str, x0: Any = None, t: Any = None, u: Mapping[str, Any] | None = None) -> str:
    """Return a model in a format of one file; see `atoll.Model.export`."""
    chosen = format_of(name)
    if chosen.of_content is not None:
        return chosen.of_content(content_of(model, x0, t, u, chosen.without_tables))
    assert chosen.of_result is not None
    return chosen.of_result(model.result)
