"""A folder of tables for which the right verdicts are known: ``python -m benchmarks.verdicts.cases --data DIR``.

``cases.json`` there is a list of objects: ``file``, ``options`` as on the command line, ``truth`` (right-hand sides by
variable, null where none is to be found), ``verdicts`` (those that each equation may have, null for any). Each file is
handed over as the command line does. A case fails where the job gives no result, an equation has another verdict, or
one that is relied on ("exact", "good") has not the form of the truth. Returns 1 when one fails.
"""

import json
import shlex
import sys
from argparse import Namespace
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from pydantic import TypeAdapter, ValidationError

from atoll.cli.parser import parse
from atoll.cli.request import JobRequest, request_of
from atoll.terminal.output import clip, say, table
from atoll_coordinator.data.reading.files import read_table
from atoll_core.errors import DataError, UsageError
from benchmarks.first_hour.outcomes import CONFIDENT
from benchmarks.first_hour.tables import Columns
from benchmarks.harness.campaign import Answer, Service, journal_of, judge_again, work_off
from benchmarks.harness.command_line import option, positive, program, workers
from benchmarks.judging.forms import judge_form
from benchmarks.judging.rules import Kind
from benchmarks.verdicts.campaign import run_job
from benchmarks.verdicts.judging import NO_MODEL, End

LIST: Final = "cases.json"
LONGEST: Final = 90


@dataclass(frozen=True)
class Case:
    """One table of the folder: its file, options, right-hand sides by variable, and the verdicts that are right."""

    file: str
    options: str = ""
    truth: Mapping[str, str] | None = None
    verdicts: tuple[str, ...] | None = None

    @property
    def name(self) -> str:
        """The file and options, which no two cases share."""
        return f"{self.file} {self.options}".strip()

    def request(self, folder: Path) -> JobRequest:
        """Return what the command line makes of it; raises UsageError where an option is wrong."""
        return request_of(parse(["run", str(folder / self.file), *shlex.split(self.options)]))


@dataclass(frozen=True)
class CaseEquation:
    """One equation that came back: its verdict and whether that is right; `form` is None where no truth is known."""

    variable: str
    expression: str | None
    grade: str
    reason: str | None
    form: Kind | None
    is_allowed: bool


@dataclass(frozen=True)
class CaseOutcome:
    """How one case came out."""

    key: str
    end: End
    sentence: str
    equations: tuple[CaseEquation, ...]
    seconds: float

    @property
    def is_allowed(self) -> bool:
        """Whether there is a result, and all its verdicts are right."""
        return self.end == "done" and all(equation.is_allowed for equation in self.equations)

    @property
    def found(self) -> str:
        """Whether the truth is found, ``-`` where there is none to find."""
        forms = [equation.form for equation in self.equations if equation.form is not None]
        return "-" if not forms else "yes" if all(form == "right" for form in forms) else "no"


def cases_of(folder: Path) -> list[Case]:
    """Return the cases of a folder; raises UsageError where it has no list, DataError where that is none."""
    path = folder / LIST
    try:
        listed = json.loads(path.read_text("utf-8"))
        return TypeAdapter(list[Case]).validate_python(listed)
    except OSError as error:
        raise UsageError(f"{path} cannot be read ({error.strerror}); name a folder that has one with --data") from error
    except (ValueError, ValidationError) as error:
        raise DataError(f"{path} is no list of cases: {str(error).splitlines()[0]}") from error


def judged(case: Case, columns: Columns, result: Mapping[str, Any]) -> tuple[CaseEquation, ...]:
    """Judge the equations of a result.json; `columns` (R,) are those of the table, over which forms are compared."""
    equations = result.get("equations", ())
    missing = set(case.truth or ()) - {equation["variable"] for equation in equations}
    return tuple(
        _shown(case, columns, equation) for equation in (*equations, *({"variable": name} for name in sorted(missing)))
    )


def _shown(case: Case, columns: Columns, equation: Mapping[str, Any]) -> CaseEquation:
    variable, text, grade = equation["variable"], equation.get("expression"), equation.get("verdict") or NO_MODEL
    truth = (case.truth or {}).get(variable)
    form: Kind | None = None if truth is None else "none" if text is None else _form(text, truth, columns)
    is_listed = case.verdicts is None or grade in case.verdicts
    is_wrong = grade in CONFIDENT and form not in (None, "right")
    return CaseEquation(variable, text, grade, equation.get("reason"), form, is_listed and not is_wrong)


def _form(text: str | None, truth: str, columns: Columns) -> Kind:
    try:
        return judge_form(text, truth, columns, with_extra=True).kind
    except (UsageError, NameError):
        return "other"


def columns_of(case: Case, folder: Path) -> Columns:
    """Return the columns (R,) of a table in rows that have all of them, with velocities where these are sought."""
    asked = case.request(folder)
    read = read_table(asked.files, asked.config.data)
    whole = np.isfinite(read.columns).all(axis=0)
    columns = {name: values[whole] for name, values in zip(read.names, read.columns, strict=True)}
    if asked.config.data.order == 2:
        columns |= {f"{name}_dot": np.gradient(values) for name, values in columns.items()}
    return columns


def line(outcome: CaseOutcome) -> str:
    """Return how one case came out, for following a long run."""
    return ", ".join(row(outcome)) + (f": {outcome.sentence}" if outcome.sentence else "")


def row(outcome: CaseOutcome) -> tuple[str, str, str, str, str]:
    """Return file, verdicts, whether they are right, whether the truth is found, and seconds."""
    verdicts = ", ".join(f"{equation.variable} {equation.grade}" for equation in outcome.equations) or outcome.end
    return outcome.key, verdicts, "yes" if outcome.is_allowed else "NO", outcome.found, f"{outcome.seconds:.1f}"


def _faults(outcome: CaseOutcome) -> Iterator[str]:
    if outcome.end != "done":
        yield f"FAILED {outcome.key}: {outcome.end}: {outcome.sentence}"
    for equation in outcome.equations:
        if not equation.is_allowed:
            shown = f"{equation.variable} = {clip(equation.expression or '-', LONGEST)}"
            yield f"FAILED {outcome.key}: {equation.grade}: {shown}; {equation.reason}"


@program(
    "benchmarks.verdicts.cases",
    __doc__,
    option("--data", type=Path, required=True, metavar="DIR", help="folder of the tables and cases.json"),
    option("--cases", nargs="+", metavar="WORD", help="parts of file names; default: all"),
    workers(1),
    option("--limit", type=positive, default=900.0, help="seconds after which a job is late (%(default)g)"),
    option("--out", "--resume", type=Path, metavar="FILE", help="file of JSON lines, gone on with"),
    option("--only-judge", action="store_true", help="search nothing; judge what the file holds"),
)
def main(options: Namespace) -> int:
    """Do what the options ask for."""
    cases = {case.name: case for case in cases_of(options.data)}
    wanted = [name for name in cases if not options.cases or any(word in name for word in options.cases)]
    journal = journal_of("verdicts.cases", CaseOutcome, options)

    def do(service: Service, name: str) -> tuple[CaseOutcome, Answer]:
        case = cases[name]
        asked = run_job(service(), name, lambda: case.request(options.data), options.limit)
        equations = judged(case, columns_of(case, options.data), asked.result) if asked.result else ()
        return CaseOutcome(name, asked.end, asked.sentence, equations, asked.seconds), asked.result or None

    def again(name: str, old: CaseOutcome, answer: Mapping[str, Any]) -> CaseOutcome:
        equations = judged(cases[name], columns_of(cases[name], options.data), answer)
        return CaseOutcome(name, old.end, old.sentence, equations, old.seconds)

    if options.only_judge:
        judge_again(wanted, journal, again)
        outcomes = [journal.outcomes[name] for name in wanted if name in journal.outcomes]
    else:
        outcomes = work_off(wanted, journal, do, line, options.workers)
    failed = [outcome for outcome in outcomes if not outcome.is_allowed]
    say(table(("case", "verdicts", "right", "truth found", "s"), map(row, outcomes)))
    say("\n".join(["", *(fault for outcome in failed for fault in _faults(outcome))]))
    say(f"{len(outcomes) - len(failed)} of {len(outcomes)} cases as they should be")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
