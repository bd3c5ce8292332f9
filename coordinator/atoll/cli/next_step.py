"""The one command that is worth trying after a run has ended, by what came of it. Pure."""

import re
import shlex
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final, cast

from atoll_coordinator.result.result import Result
from atoll_core.command_line import duration

_OPTION: Final = re.compile(r"--(robust|stochastic)\b")
"""Options that the reason of a verdict or a warning proposes, and which take no value."""

_ADDED: Final = re.compile(
    r"\badd --(missing-value|hold|order|per-trajectory|inputs|states)(?: ('[^']*'|[^\s;,.]\S*?))?(?=[;,.]?(?:\s|$))"
)
"""Options with their values that a warning says to add: what the columns themselves say."""

_WHY: Final = {
    "missing-value": "a number that stands for missing values was taken as measured",
    "hold": "the inputs seem to be constant between rows",
    "order": "the same values are passed with different velocities",
    "per-trajectory": "the trajectories seem to differ in a constant",
    "inputs": "a column, or the time, seems to act from outside",
    "states": "the columns determine each other",
}
"""The options that are proposed, the most useful first, and what for."""

_NOT_STOCHASTIC: Final = ("order", "target", "derivatives", "only", "robust", "weights", "offsets")
"""Settings that exclude ``--stochastic``."""

_MORE_OPERATORS: Final = "+,-,*,/,sin,cos,exp,sqrt,tanh"
_LONGER: Final = "the search ended before it had converged"
_NOT_REFINED: Final = "the time was over before the equations were fitted to trajectories and compared"

_Proposal = tuple[list[str], str]
"""The words of a command, and what it is for."""


def next_step(result: Result, folder: Path, words: Sequence[str], program: str = "coordinator") -> str | None:
    """Return a command and, behind two spaces and ``#``, what it is for; None where there is nothing to propose.

    `result` is of a job that has ended, written into `folder`; `words` of the command line that gave it, of a
    `program` that is called like this.
    """
    if result.state == "cancelled" and result.refining == "not refined":
        why = "it was interrupted before the equations were fitted to trajectories and compared"
        proposal = _elsewhere(words), why
    elif result.state != "done" or not result.equations:
        return None
    else:
        proposal = (
            _again_with_columns(result, words)
            or _again_with_option(result, words)
            or _again_for_longer(result, words)
            or _again_with_operators(result, words)
            or _with_result(result, str(folder))
        )
    command, purpose = proposal
    return f"{shlex.join([program, *command])}  # {purpose}"


def _again_with_option(result: Result, words: Sequence[str]) -> _Proposal | None:
    """Propose an option that a sentence of the result names."""
    sentences = [*result.warnings, *(equation.reason or "" for equation in result.equations)]
    given = result.data_settings
    named = [match[1] for sentence in sentences for match in _OPTION.finditer(sentence)]
    is_excluded = {"robust": False, "stochastic": any(name in given for name in _NOT_STOCHASTIC)}
    free = [name for name in named if not given.get(name) and not is_excluded[name]]
    if not free:
        return None
    fitting = f"--{free[0]}"
    why = "some measurements look like outliers" if fitting == "--robust" else "noise may be part of the law"
    return [*_elsewhere(words), fitting], why


def _again_with_columns(result: Result, words: Sequence[str]) -> _Proposal | None:
    """Propose what a warning says of the columns, unless every equation is good; of missing values in any case."""
    added = {match[1]: match[2] for sentence in reversed(result.warnings) for match in _ADDED.finditer(sentence)}
    is_good = all(equation.verdict in ("exact", "good") for equation in result.equations)
    for option, why in _WHY.items():
        if option in added and not (is_good and option != "missing-value"):
            flag, value = f"--{option}", [*shlex.split(added[option] or "")]
            before = _elsewhere(words)
            return [*(before if option == "missing-value" else _without(before, flag)), flag, *value], why
    return None


def _again_for_longer(result: Result, words: Sequence[str]) -> _Proposal | None:
    """Propose twice the budget where it ended the search of an equation that is not good, or refining it."""
    ends = {equation.why for equation in result.equations if equation.verdict not in ("exact", "good")}
    budget = result.settings("budget")
    is_cut = bool(ends) and result.refining in ("not refined", "max-time")
    if ("max-time" in ends or is_cut) and budget.get("max_time") is not None:
        seconds = _seconds(words) or cast(float, budget["max_time"])
        again = [*_without(_elsewhere(words), "--max-time"), "--max-time", f"{2.0 * seconds:g}s"]
        return again, _NOT_REFINED if is_cut else _LONGER
    if "max-epochs" in ends and budget.get("max_epochs") is not None and not budget.get("max_epochs_of"):
        epochs = f"{2 * cast(int, budget['max_epochs'])}"
        return [*_without(_elsewhere(words), "--max-epochs"), "--max-epochs", epochs], _LONGER
    return None


def _again_with_operators(result: Result, words: Sequence[str]) -> _Proposal | None:
    """Propose more operators where nothing was found with the usual ones."""
    is_nothing = any(equation.verdict == "no model" for equation in result.equations)
    if not is_nothing or result.settings("space"):
        return None
    return [*_elsewhere(words), "--operators", _MORE_OPERATORS], "expressions may need more than the usual operators"


def _with_result(result: Result, folder: str) -> _Proposal:
    """Propose what to do with the equations."""
    kind = result.columns.kind
    if kind == "regression":
        return ["result", f"{folder}/result.json", "--format", "latex"], "the equation for a paper"
    if any(equation.verdict == "no model" for equation in result.equations):
        return ["result", f"{folder}/result.json"], "the best expression of each size"
    is_driven = kind == "process" or result.columns.inputs
    is_told = result.simulated or result.recorded  # of a job that was cut nothing may tell an initial state
    if is_driven and is_told:
        return ["simulate", folder, "-o", f"{folder}/simulation.csv"], "the model along what was measured"
    if any(not constant.identifiable for equation in result.equations for constant in equation.constants):
        return ["analyse", folder, "--identifiability"], "which constants the data determine"
    if any(equation.verdict == "doubtful" and equation.candidates for equation in result.equations):
        return ["suggest", folder], "the experiment that would decide between the candidates"
    return ["analyse", folder], "fixed points, limit cycles and basins of the model"


def _seconds(words: Sequence[str]) -> float | None:
    """Return the time that the command line allows; a result has what was left of it once programs had started."""
    given = [after for word, after in pairwise(words) if word == "--max-time"]
    given += [word.partition("=")[2] for word in words if word.startswith("--max-time=")]
    return duration(given[-1]) if given else None


def _elsewhere(words: Sequence[str]) -> list[str]:
    """Return the words without the names of what there is now: a job's id, and the folder of a result."""
    return _without(_without(words, "--out"), "--id")


def _without(words: Sequence[str], option: str) -> list[str]:
    """Return the words without an option and its value."""
    kept: list[str] = []
    is_value = False
    for word in words:
        if not is_value and word != option and not word.startswith(f"{option}="):
            kept.append(word)
        is_value = not is_value and word == option
    return kept
