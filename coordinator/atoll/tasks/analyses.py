"""Questions about a result: its dynamics, identifiability, the next experiments, a report.

The command line answers a question about a saved result in its own process; for a job of a coordinator, a worker
answers it as a task. The answer is a pure function of the result, the question and, if given, a table of measurements.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

from atoll.experiments.designs import DesignRequest
from atoll.model.core import ModelCore
from atoll.model.equations import LEVEL
from atoll.terminal.output import as_json
from atoll_coordinator.model.batches import Spread
from atoll_coordinator.result.result import Result
from atoll_core.data.table import Table
from atoll_core.errors import AtollError, RefusedError
from atoll_core.wire.messages.tasks import AnalysisFunction
from atoll_core.wire.values import decode_value, encode_value

Form = Literal["text", "json"]
"""Readable text, or plain data with all curves."""


@dataclass(frozen=True, kw_only=True)
class Question:
    """A question about a result, or about the model of one of its groups of trajectories."""

    group: str | None = None


@dataclass(frozen=True, kw_only=True)
class AnalyseDynamics(Question):
    """The dynamics of the model, see `atoll.Model.analyse`."""

    box: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    inputs: Mapping[str, float] = field(default_factory=dict)
    vary: tuple[str, tuple[float, float]] | None = None
    form: Form = "text"


@dataclass(frozen=True, kw_only=True)
class Profile(Question):
    """Which constants the data determine, see `atoll.Model.identifiability`."""

    level: float = LEVEL
    form: Form = "text"


@dataclass(frozen=True, kw_only=True)
class Suggest(Question):
    """The next experiments, see `atoll.Model.suggest`."""

    request: DesignRequest
    form: Form = "text"


@dataclass(frozen=True, kw_only=True)
class Report(Question):
    """The result as one HTML page and, on request, its pictures as SVG by name."""

    pictures: bool = False


@dataclass(frozen=True)
class Analysed:
    """The answer to a question: `text` in the requested form, and `pictures` by file name."""

    text: str
    pictures: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Outcome:
    """The result of the task: the answer, or an error; `is_refused`: the question caused the error."""

    analysed: Analysed | None = None
    sentence: str = ""
    is_refused: bool = False


FUNCTIONS: Final[Mapping[type[Question], AnalysisFunction]] = {
    AnalyseDynamics: "analyse", Profile: "profile", Suggest: "suggest", Report: "report",
}  # fmt: skip
"""The function that answers each kind of question."""

_QUESTIONS: Final[Mapping[AnalysisFunction, type[Question]]] = {name: kind for kind, name in FUNCTIONS.items()}


def answer(result: Result, question: Question, table: Table | None = None, spread: Spread | None = None) -> Analysed:
    """Answer a question about a result.

    Args:
        result: the result of a job.
        question: question of a kind in `FUNCTIONS`.
        table: measurements to use instead of the measurements in the result, for profiles and suggestions.
        spread: distributes the work over workers.

    Raises:
        UsageError: a name or a number in the question does not fit the result.
        AtollError: the model cannot be simulated.
    """
    match question:
        case AnalyseDynamics():
            from atoll.analysis.analyse import analyse_model

            model = _model(result, question)
            analysis = analyse_model(model, question.box, inputs=question.inputs, vary=question.vary, spread=spread)
            return _formed(question.form, analysis.as_dict, analysis.__str__)
        case Profile():
            from atoll.experiments.identifiability import identify

            model = _model(result, question)
            model.require_one_group()
            known = identify(model.result, table, question.level, spread)
            return _formed(question.form, known.as_dict, known.__str__)
        case Suggest():
            from atoll.experiments.suggestion import suggest

            suggested = suggest(_model(result, question).result, question.request, table, spread)
            return _formed(question.form, suggested.as_dict, suggested.__str__)
        case Report():
            from atoll.report.page import as_text, build_page, pictures

            page = build_page(result if question.group is None else _model(result, question).result, spread)
            return Analysed(as_text(page), pictures(page) if question.pictures else {})
    raise TypeError(f"{type(question).__name__} is not a question about a result")


def analyse(
    function: AnalysisFunction, result: bytes, question: bytes, table: bytes | None, spread: Spread | None = None
) -> bytes:
    """Return the encoded `Outcome` for a result as JSON, an encoded question of `function`, and an uploaded table."""
    asked: Question = decode_value(question, _QUESTIONS[function])
    try:
        rows = None if table is None else Table.from_bytes(table)
        return encode_value(Outcome(answer(Result.of(json.loads(result)), asked, rows, spread)))
    except AtollError as error:
        return encode_value(Outcome(None, error.on_command_line, error.exit_code == RefusedError.exit_code))


def answered(outcome: bytes) -> Analysed:
    """Return the answer in an encoded `Outcome`; raises RefusedError or AtollError if it holds an error."""
    made = decode_value(outcome, Outcome)
    if made.analysed is None:
        raise (RefusedError if made.is_refused else AtollError)(made.sentence)
    return made.analysed


def _model(result: Result, question: Question) -> ModelCore:
    return ModelCore(result) if question.group is None else ModelCore(result).of_group(question.group)


def _formed(form: Form, as_dict: Callable[[], object], as_text: Callable[[], str]) -> Analysed:
    return Analysed(as_json(as_dict()) if form == "json" else as_text())
