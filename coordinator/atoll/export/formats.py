"""The table of formats of one file: languages, and what is written of a result, which need not be a model."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Final

from atoll.export import c, julia, matlab, modelica, python, sbml, text, xppaut
from atoll.export.description import Description, HeldInputs, Times, describe
from atoll.export.language import Language
from atoll.model.beginnings import Given
from atoll_coordinator.result.result import Result
from atoll_core.errors import UsageError
from atoll_core.quoting import enumerated

if TYPE_CHECKING:
    from atoll.model.model import Model

LANGUAGES: Final[Mapping[str, Language]] = {
    "python": python.LANGUAGE,
    "c": c.LANGUAGE,
    "julia": julia.LANGUAGE,
    "matlab": matlab.LANGUAGE,
    "modelica": modelica.LANGUAGE,
    "xppaut": xppaut.LANGUAGE,
    "sbml": sbml.LANGUAGE,
}
OF_RESULTS: Final[Mapping[str, Callable[[Result], str]]] = {
    "latex": text.as_latex,
    "sympy": text.as_sympy,
    "csv": text.as_csv,
    "json": Result.to_json,
}
PETAB: Final = "petab"
"""A folder, with a writer of its own (`atoll.export.petab`)."""
NAMES: Final = (*LANGUAGES, *OF_RESULTS, PETAB)


def written(model: "Model", name: str, x0: Given | None = None, t: Times = None, u: HeldInputs = None) -> str:
    """Return the model in a format of one file, by its name; see `atoll.Model.export`."""
    if name in OF_RESULTS:
        return OF_RESULTS[name](model.result)
    if name not in LANGUAGES:
        known = ", ".join([*LANGUAGES, *OF_RESULTS])
        raise UsageError(f"{name!r} is no format of an export; choose one of {known}, or petab with a folder")
    return write(describe(model, x0, t, u, LANGUAGES[name].without_tables), LANGUAGES[name])


def write(model: Description, language: Language) -> str:
    """Return a file of a language; raises UsageError where it cannot hold the model."""
    require_holds(model, language)
    return language.write(model)


def require_holds(model: Description, language: Language) -> None:
    """Raise UsageError where a process would lose its noise, a regression its function, or an input its table."""
    if model.covariance and not language.has_noise:
        able = enumerated([name for name, other in LANGUAGES.items() if other.has_noise])
        raise UsageError(f"{language.name} cannot hold the noise of a process; {able} can")
    if not model.states and not language.regression:
        able = ", ".join([name for name, other in LANGUAGES.items() if other.regression])
        raise UsageError(
            f"{language.name} holds what moves in time, and this model does not; {able}, latex and sympy can"
        )
    if model.tables and not language.has_tables:
        raise UsageError(
            f"{language.name} cannot hold the table of the input '{model.tables[0].name}'; give one number for it"
        )
