"""How one job came out: form, extra terms, verdict and prediction of each equation, and what the job took."""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

from atoll.config import JobConfig
from atoll.errors import UsageError
from atoll.wire.messages.views import JobView
from benchmarks.corpus.cases import LEAST_T, Case, Key
from benchmarks.corpus.forms import Kind, judge_form
from benchmarks.corpus.lengths import excess_of_truth
from benchmarks.harness.stopwatch import Stopwatch
from benchmarks.judging.generalisation import GOOD_R2, field_of, simulated

MOST_LOOKED_AT: Final = 60
"""So many equations of a front and of the candidates are looked at for the truth."""


@dataclass(frozen=True)
class EquationOutcome:
    """How one equation came out.

    `form` and `extra` are those of `benchmarks.corpus.forms`; `t` is the smallest estimate over standard error of a
    constant that the data allow (infinite without constants); `elsewhere` says where the true form is when it is not
    shown: "candidates" or "front", `nats` how much longer its description is there; `r2` is that of the state along
    all fresh trajectories together, -inf where the model cannot be simulated, None where there are none.
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

    @property
    def is_right(self) -> bool:
        """Whether the form is right, with nothing else."""
        return self.form == "right"

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

    def to_json(self) -> dict[str, Any]:
        """Return plain values; numbers that are not finite become text."""
        return {name: _plain(value) for name, value in asdict(self).items()}


def outcome_from(value: Mapping[str, Any]) -> Outcome:
    """Return the outcome that `to_json` wrote; raises KeyError or TypeError when it is something else."""
    equations = tuple(
        EquationOutcome(**{name: _number(part) for name, part in each.items()}) for each in value["equations"]
    )
    excess = _number(value.get("excess"))
    return Outcome(**{**value, "key": Key(**value["key"]), "equations": equations, "excess": excess})


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _plain(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def _number(value: Any) -> Any:
    return float(value) if value in ("inf", "-inf", "nan") else value


def judge_job(
    key: Key, case: Case, result: Mapping[str, Any], meter: "Meter | None" = None, failure: str | None = None,
    config: JobConfig | None = None,
) -> Outcome:  # fmt: skip
    """Judge `result`, the contents of a result.json, empty when the job failed.

    With the `config` of the job, the description lengths of truth and result are compared where that is wrong.
    """
    equations = {equation["variable"]: equation for equation in result.get("equations", ())}
    truths = case.system.truths
    r2 = fresh_r2([equations.get(state, {}).get("expression") for state in truths], case)
    judged = tuple(_equation(case, state, equations.get(state, {}), r2[state]) for state in truths)
    wall, cpu = ({}, {}) if meter is None else (meter.stopwatch.seconds, meter.cpu)
    excess = None
    if config is not None and not all(its.is_right for its in judged):
        excess = excess_of_truth(case.table, config, truths, [its.expression for its in judged])
    return Outcome(
        key, case.system.name, judged, float(result.get("seconds") or 0.0), wall, cpu, result.get("digest"), failure,
        excess,
    )  # fmt: skip


def _equation(case: Case, state: str, equation: Mapping[str, Any], r2: float | None) -> EquationOutcome:
    text = equation.get("expression")
    truth = case.system.truths[state]
    form = judge_form(text, truth, case.clean)
    elsewhere, nats = (None, None) if form.is_right else _elsewhere(case, truth, equation)
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
    )


def _elsewhere(case: Case, truth: str, equation: Mapping[str, Any]) -> tuple[str | None, float | None]:
    for place in ("candidates", "front"):
        for each in (equation.get(place) or [])[:MOST_LOOKED_AT]:
            if judge_form(each.get("expression"), truth, case.clean, with_extra=False).is_right:
                return place, each.get("nats")
    return None, None


def fresh_r2(expressions: Sequence[str | None], case: Case) -> dict[str, float | None]:
    """Return R2 of each state over all fresh trajectories: squared errors over squares about the mean of all."""
    states = case.system.states
    if not case.fresh:
        return dict.fromkeys(states)
    try:
        field = field_of([text for text in expressions if text], states)
    except UsageError:
        return dict.fromkeys(states, -math.inf)
    found = [simulated(field, path) if all(expressions) else None for path in case.fresh]
    if any(each is None for each in found):
        return dict.fromkeys(states, -math.inf)
    true = [path.states for path in case.fresh]
    mean = sum(each.sum(axis=0) for each in true) / sum(len(each) for each in true)
    errors = sum(((each - its) ** 2).sum(axis=0) for each, its in zip(found, true, strict=True) if each is not None)
    spread = sum(((its - mean) ** 2).sum(axis=0) for its in true)
    return {state: float(1.0 - errors[place] / max(float(spread[place]), 1e-300)) for place, state in enumerate(states)}


@dataclass
class Meter:
    """Takes wall and processor time of a job by its state, of the processes `pids` and all below them."""

    pids: Sequence[int]
    stopwatch: Stopwatch = field(default_factory=Stopwatch)
    cpu: dict[str, float] = field(default_factory=dict)
    _last: float | None = None

    def watch(self, view: JobView) -> None:
        """Add what passed since the last look to the state that the job is in; see `Stopwatch.watch`."""
        now = cpu_seconds(self.pids)
        if self._last is not None:
            self.cpu[view.state] = self.cpu.get(view.state, 0.0) + max(now - self._last, 0.0)
        self._last = now
        self.stopwatch.watch(view)


def cpu_seconds(pids: Sequence[int]) -> float:
    """Return the processor seconds of some processes and all below them, as far as /proc tells."""
    parents: dict[int, int] = {}
    ticks: dict[int, int] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text("utf-8").rpartition(")")[2].split()
        except (OSError, IndexError):
            continue
        parents[int(folder.name)] = int(fields[1])
        ticks[int(folder.name)] = sum(map(int, fields[11:15]))  # own, and of children that ended
    below = set(pids)
    while children := {pid for pid, parent in parents.items() if parent in below and pid not in below}:
        below |= children
    return sum(ticks.get(pid, 0) for pid in below) / os.sysconf("SC_CLK_TCK")
