"""How one job came out: form, extra terms, verdict and prediction of each equation, and what the job took."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np

from atoll_core.config import JobConfig
from benchmarks.corpus.cases import LEAST_T, Case, Key
from benchmarks.corpus.lengths import excess_of_truth
from benchmarks.harness.stopwatch import Stopwatch
from benchmarks.judging.coverage import Covered, covered
from benchmarks.judging.forms import judge_form
from benchmarks.judging.generalisation import GOOD_R2, foretold
from benchmarks.judging.rules import Kind, right_ones

MOST_LOOKED_AT: Final = 60
"""So many equations of a front and of the candidates are looked at for the truth."""


@dataclass(frozen=True)
class EquationOutcome:
    """How one equation came out.

    `form` and `extra` are those of `benchmarks.judging.forms`; `t` is the smallest estimate over standard error of a
    constant that the data allow (infinite without constants); `elsewhere` says where the true form is when it is not
    shown: "candidates" or "front", `nats` how much longer its description is there; `r2` is that of the state along
    all fresh trajectories together, -inf where the model cannot be simulated, None where there are none; `covered` of
    the `intervals` (95 %) of a right equation's constants hold the truth.
    """

    variable: str
    truth: str
    expression: str | None
    form: Kind
    extra: int | None
    t: float | None
    elsewhere: str | None
    nats: float | None
    r2: float | None
    grade: str | None
    reason: str | None
    complexity: int | None
    why: str | None
    epochs: int | None
    covered: int = 0
    intervals: int = 0

    @property
    def is_right(self) -> bool:
        """Whether the form is right, with nothing else."""
        return self.form == "right"

    @property
    def shown_form(self) -> str:
        """The form, and how many terms are too many."""
        return self.form + (f" {self.extra}" if self.extra else "")

    @property
    def place(self) -> str:
        """Where the true form is when it is not shown, and how much longer its description is."""
        return (self.elsewhere or "") + (
            "" if self.elsewhere is None or self.nats is None else f" {self.nats:+.1f} nats"
        )

    @property
    def is_identifiable(self) -> bool:
        """Whether the data could tell every constant from zero."""
        return self.t is None or self.t >= LEAST_T

    @property
    def is_foretold(self) -> bool | None:
        """Whether fresh trajectories are foretold; None where there are none."""
        return None if self.r2 is None else self.r2 > GOOD_R2


@dataclass(frozen=True)
class Outcome:
    """How one job came out. `seconds` is the whole job's wall time; by phase, `wall` and `cpu` of all processes.

    `excess` is how many nats longer the description is with the truth, None where all is right or it is not known.
    """

    key: Key
    system: str
    equations: tuple[EquationOutcome, ...]
    seconds: float
    wall: Mapping[str, float]
    cpu: Mapping[str, float]
    digest: str | None = None
    failure: str | None = None
    excess: float | None = None

    @property
    def cpu_seconds(self) -> float:
        """Seconds of one core that the job took in all."""
        return sum(self.cpu.values())


def judge_job(
    key: Key, case: Case, result: Mapping[str, Any], stopwatch: Stopwatch | None = None, failure: str | None = None,
    config: JobConfig | None = None,
) -> Outcome:  # fmt: skip
    """Judge `result`, the contents of a result.json, empty when the job failed.

    With the `config` of the job, the description lengths of truth and result are compared where that is wrong.
    """
    equations = {equation["variable"]: equation for equation in result.get("equations", ())}
    truths = case.system.truths
    texts = {state: equations.get(state, {}).get("expression") for state in truths}
    r2: Mapping[str, float | None] = foretold(texts, case.fresh) if case.fresh else dict.fromkeys(truths)
    judged = tuple(_equation(case, state, equations.get(state, {}), r2[state]) for state in truths)
    wall, cpu = ({}, {}) if stopwatch is None else (stopwatch.seconds, stopwatch.processor)
    excess = None
    if config is not None and not config.prior.equations and not all(equation.is_right for equation in judged):
        excess = excess_of_truth(case.table, config, truths, [equation.expression for equation in judged])
    return Outcome(
        key, case.system.name, judged, float(result.get("seconds") or 0.0), wall, cpu, result.get("digest"), failure,
        excess,
    )  # fmt: skip


def _equation(case: Case, state: str, equation: Mapping[str, Any], r2: float | None) -> EquationOutcome:
    text = equation.get("expression")
    truth = case.system.truths[state]
    form = judge_form(text, truth, case.clean)
    elsewhere, nats = (None, None) if form.is_right else _elsewhere(case, truth, equation)
    held = _intervals(case, state, equation) if form.is_right else []
    return EquationOutcome(
        variable=state,
        truth=truth,
        expression=text,
        form=form.kind,
        extra=form.extra,
        t=case.t[state],
        elsewhere=elsewhere,
        nats=nats,
        r2=r2,
        grade=equation.get("verdict"),
        reason=equation.get("reason"),
        complexity=equation.get("complexity"),
        why=equation.get("why"),
        epochs=equation.get("epoch"),
        covered=sum(constant.is_covered for constant in held),
        intervals=len(held),
    )


def _intervals(case: Case, state: str, equation: Mapping[str, Any]) -> list[Covered]:
    """Return the constants of a right equation that have an interval, beside their true values."""
    names = list(case.clean)
    rates = np.array([case.system.field()(row) for row in zip(*case.clean.values(), strict=True)])
    truth = rates[:, list(case.system.truths).index(state)]
    constants = covered(equation["expression"], equation.get("constants", ()), {n: case.clean[n] for n in names}, truth)
    return [constant for constant in constants or () if constant.has_interval]


def _elsewhere(case: Case, truth: str, equation: Mapping[str, Any]) -> tuple[str | None, float | None]:
    rule = partial(judge_form, truth=truth, columns=case.clean, with_extra=False)
    for place in ("candidates", "front"):
        for member in right_ones(rule, (equation.get(place) or [])[:MOST_LOOKED_AT]):
            return place, member.get("nats")
    return None, None
