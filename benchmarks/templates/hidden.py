"""Systems with a known part: the job of one system, and how it came out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from atoll_core.config import DataConfig, JobConfig, ParameterConfig, PriorConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from benchmarks.harness.jobs import configured
from benchmarks.harness.solving import solve
from benchmarks.harness.systems import Sampled
from benchmarks.harness.systems import table_of as table_of_samples
from benchmarks.harness.tables import grouped, markdown, share
from benchmarks.judging.forms import judge_form
from benchmarks.judging.generalisation import field_of
from benchmarks.templates.systems import SYSTEMS, TemplateSystem


@dataclass(frozen=True, order=True)
class SystemKey:
    """One job: name of the system, noise in per cent of each column's standard deviation, seed."""

    system: str
    noise: int
    seed: int

    @property
    def title(self) -> str:
        """The key as people read it."""
        return f"{self.system}, {self.noise} %, seed {self.seed}"


def measured(key: SystemKey) -> tuple[FloatArray, list[FloatArray], list[FloatArray]]:
    """Return the times (n,), and for each trajectory the true states (n, S) and the measured columns (n, C)."""
    system = SYSTEMS[key.system]
    times = np.linspace(0.0, system.duration, system.rows)
    field = field_of(list(system.truths.values()), system.states)
    states = [
        solve(
            lambda state: field(state.tolist()), start, times, limit=1e8, most_evaluations=200_000, method="DOP853",
            rtol=1e-11, atol=1e-13,
        )
        for start in system.starts
    ]  # fmt: skip
    kept = [index for index, name in enumerate(system.states) if name in system.columns]
    computed = field_of(list(system.observed_truths.values()), system.states) if system.observed else None
    rng = np.random.default_rng([key.noise, key.seed])
    clean = [
        np.column_stack([part[:, kept], *([[computed(row) for row in part.tolist()]] if computed else [])])
        for part in states
    ]
    deviations = np.concatenate(clean).std(axis=0)
    columns = [part + 0.01 * key.noise * deviations * rng.standard_normal(part.shape) for part in clean]
    return times, states, columns


def request_of(key: SystemKey) -> tuple[Table, JobConfig]:
    """Return the table of one job and its configuration."""
    system = SYSTEMS[key.system]
    times, _, columns = measured(key)
    table = table_of_samples(Sampled(system.columns, (times,) * len(columns), tuple(columns)))
    prior = PriorConfig(
        equations=dict(system.given),
        parameters={
            name: ParameterConfig(lower=low, upper=high, by="run" if name in system.by_run else None)
            for name, (low, high) in system.parameters.items()
        },
        initial={name: _initial(value) for name, value in system.initial.items()},
    )
    config = configured(key.seed)
    data = DataConfig(hidden=system.hidden, observe=dict(system.observed))
    return table, config.model_copy(update={"prior": prior, "data": data})


def _initial(value: float | tuple[float, float]) -> ParameterConfig:
    return ParameterConfig(lower=value[0], upper=value[1]) if isinstance(value, tuple) else ParameterConfig(start=value)


@dataclass(frozen=True)
class SystemOutcome:
    """How one job came out.

    `errors` are the relative errors of the parameters, `covered` how many of their `intervals` hold the truth. `forms`
    tell by label whether the unknown part is right. `hidden` is the smallest R2 of a hidden state (None: there is
    none). `grades` are the verdicts by state.
    """

    key: SystemKey
    errors: Mapping[str, float]
    covered: int
    intervals: int
    forms: Mapping[str, str]
    rests: Mapping[str, str]
    hidden: float | None
    grades: Mapping[str, str | None]
    seconds: float
    failure: str | None = None


def judge(key: SystemKey, result: Mapping[str, Any], seconds: float, failure: str | None) -> SystemOutcome:
    """Return how the result of one job came out."""
    system, (times, states, _) = SYSTEMS[key.system], measured(key)
    equations = result.get("equations", ())
    found = dict[str, Any]()
    rests = dict[str, str]()
    for part in (*equations, *result.get("observations", ())):
        given = part.get("given") or {}
        found |= {name: part["constants"][place] for name, place in given.get("parameters", {}).items()}
        found |= {f"{part['variable']}[{one['run']}]": one for one in part.get("runs", ())}
        rests |= {one["label"]: one["expression"] for one in given.get("unknowns", ())}
    errors = {
        name: abs(found[name]["value"] / value - 1.0) if name in found else np.inf
        for name, value in system.known.items()
    }
    intervals = {name: found[name].get("interval") for name in system.known if name in found}
    known = {name: ends for name, ends in intervals.items() if ends and None not in ends}
    covered = sum(ends[0] <= system.known[name] <= ends[1] for name, ends in known.items())
    columns = {name: np.concatenate([part[:, at] for part in states]) for at, name in enumerate(system.states)}
    forms = {label: judge_form(rests.get(label), truth, columns).kind for label, truth in system.rests.items()}
    return SystemOutcome(
        key, errors, covered, len(known), forms, rests, _hidden_r2(system, result, times, states),
        {one["variable"]: one.get("verdict") for one in equations}, seconds, failure,
    )  # fmt: skip


def _hidden_r2(
    system: TemplateSystem, result: Mapping[str, Any], times: FloatArray, states: Sequence[FloatArray]
) -> float | None:
    """Return the smallest R2 of the simulated hidden states along all trajectories."""
    listed = (result.get("simulation") or {}).get("trajectories") or []
    if not system.hidden:
        return None
    if len(listed) != len(states):
        return -np.inf
    shares = []
    for name in system.hidden:
        place = system.states.index(name)
        squares = spread = 0.0
        for part, truth in zip(listed, states, strict=True):
            values = np.array((part.get("values") or {}).get(name) or [np.nan], np.float64)
            if len(values) != len(part["times"]):
                return -np.inf
            right = np.interp(np.array(part["times"]), times, truth[:, place])
            squares += float(np.nansum((values - right) ** 2)) + (np.inf if np.isnan(values).any() else 0.0)
            spread += float(((right - right.mean()) ** 2).sum())
        shares.append(1.0 - squares / spread)
    return min(shares)


def line(outcome: SystemOutcome) -> str:
    """Return how one job came out, for following a long run."""
    worst = max(outcome.errors.values(), default=0.0)
    hidden = "" if outcome.hidden is None else f", hidden R2 {outcome.hidden:.4f}"
    return (
        f"{outcome.key.title}: parameters within {100.0 * worst:.2g} %, {outcome.covered} of {outcome.intervals} "
        f"covered{hidden}, rests {dict(outcome.forms)} {dict(outcome.rests)}, {dict(outcome.grades)}; "
        f"{outcome.seconds:.1f} s{'; ' + outcome.failure if outcome.failure else ''}"
    )


def table_of(outcomes: Sequence[SystemOutcome]) -> str:
    """Return the table of all systems, in Markdown."""
    rows = []
    for (system, noise), chosen in grouped(outcomes, lambda one: (one.key.system, one.key.noise)).items():
        hidden = [one.hidden for one in chosen if one.hidden is not None]
        good = [grade in ("exact", "good") for one in chosen for grade in one.grades.values()]
        forms = [form == "right" for one in chosen for form in one.forms.values()]
        errors = [max(one.errors.values()) for one in chosen if one.errors]
        rows.append((
            system, f"{noise} %", f"{100.0 * float(np.median(errors)):.2g} %" if errors else "-",
            share(sum(one.covered for one in chosen), sum(one.intervals for one in chosen)),
            share(sum(forms), len(forms)) if forms else "-", f"{min(hidden):.4f}" if hidden else "-",
            share(sum(good), len(good)), f"{np.median([one.seconds for one in chosen]):.1f}",
        ))  # fmt: skip
    heads = (
        "system", "noise", "largest error of a parameter", "intervals hold", "unknown part right",
        "least R2 of a hidden state", "good", "median s",
    )  # fmt: skip
    return markdown(heads, rows)
