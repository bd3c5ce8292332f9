"""Runs with inputs: solutions of laws and models, R² along fresh runs, and which constants the data determine."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from benchmarks.harness.solving import DivergedError, solve
from benchmarks.judging.generalisation import LIMIT, MAX_EVALUATIONS, field_of, r_squared

Texts = Mapping[str, str]
"""Right-hand sides by state, in the order of the states."""

Input = Callable[[float], float]

CONSTANT: Final = re.compile(r"\bk\d+\b")
_SHIFT: Final = 1e-4
_REDUNDANT: Final = 1e-12


@dataclass(frozen=True, eq=False)
class Run:
    """One run: constants of the law by name, initial state (S,), times (n,), inputs by name, and its group.

    `is_held`: inputs keep the value that they have at a time until the next of `times`.
    """

    constants: Mapping[str, float]
    start: tuple[float, ...]
    times: FloatArray
    inputs: Mapping[str, Input] = field(default_factory=dict)
    is_held: bool = False
    group: str = ""


def with_numbers(texts: Texts, constants: Mapping[str, float]) -> dict[str, str]:
    """Return right-hand sides with numbers for the names of constants."""
    return {
        state: CONSTANT.sub(lambda match: f"({constants[match[0]]!r})", text).replace("--", "+")
        for state, text in texts.items()
    }


def simulate(texts: Texts, run: Run, precision: float = 1e-9, evaluations: int = MAX_EVALUATIONS) -> FloatArray:
    """Return the states (n, S) of a run by right-hand sides without names of constants.

    Raises DivergedError where a solution runs away, UsageError where a text is no expression over states and inputs.
    """
    slopes = field_of([*texts.values()], (*texts, *run.inputs))
    inputs = tuple(run.inputs.values())

    def rates(state: FloatArray) -> list[float]:
        *values, time = state.tolist()
        return [*slopes([*values, *(one(time) for one in inputs)]), 1.0]

    if run.is_held:
        return _step_by_step(slopes, inputs, run, precision, evaluations)
    start = np.array([*run.start, float(run.times[0])])
    spread = float(run.times[-1] - run.times[0])
    states = solve(
        rates, start, run.times, limit=LIMIT, most_evaluations=evaluations, begin=float(run.times[0]),
        method="LSODA", rtol=precision, atol=1e-3 * precision, max_step=spread / 40.0,
    )  # fmt: skip
    return states[:, :-1]


def _step_by_step(
    slopes: Callable[[Sequence[float]], list[float]], inputs: Sequence[Input], run: Run, precision: float,
    evaluations: int,
) -> FloatArray:  # fmt: skip
    """Return the states of a run whose inputs jump at its times."""
    rows = [np.array(run.start)]
    for time, step in zip(run.times.tolist(), np.diff(run.times).tolist(), strict=False):
        held = [one(time) for one in inputs]

        def rates(state: FloatArray, held: list[float] = held) -> list[float]:
            return slopes([*state.tolist(), *held])

        both = solve(
            rates, rows[-1], np.array([0.0, step]), limit=LIMIT, most_evaluations=evaluations, method="LSODA",
            rtol=precision, atol=1e-3 * precision,
        )  # fmt: skip
        rows.append(both[-1])
    return np.array(rows)


def prediction_r2(models: Mapping[str, Texts], runs: Sequence[Run], true: Sequence[FloatArray]) -> dict[str, float]:
    """Return R² of each state over runs and their true states (n, S), by the model of each run's group.

    It is -inf where a run cannot be simulated or a model is none.
    """
    states = tuple(next(iter(models.values())))
    try:
        solutions = [simulate(models[run.group], run, 1e-7) for run in runs]
    except (DivergedError, UsageError):
        return dict.fromkeys(states, -math.inf)
    return dict(zip(states, r_squared([*zip(solutions, true, strict=True)]), strict=True))


def least_t(
    texts: Texts, runs: Sequence[Run], errors: Mapping[str, float], own: Sequence[str] = ()
) -> dict[str, float]:
    """Return for each state how well the least known constant of its equation can be known: estimate / standard error.

    The standard errors are those of maximum likelihood to first order, with constants and initial states free. `errors`
    are the standard deviations of the errors of the states that are measured; constants named in `own` differ between
    groups.
    """
    measured = [place for place, state in enumerate(texts) if state in errors]
    weights = np.array([1.0 / errors[state] for state in texts if state in errors])

    def values(changed: Sequence[Run]) -> FloatArray:
        solutions = [simulate(with_numbers(texts, run.constants), run) for run in changed]
        return np.concatenate([(states[:, measured] * weights).ravel() for states in solutions])

    try:
        base = values(runs)
        names, columns = [], []
        for name, changed in _constants_changed(runs, own):
            names.append(name)
            columns.append((values(changed) - base) / _SHIFT)
        columns += [(values(changed) - base) / _SHIFT for changed in _starts_changed(texts, runs)]
    except DivergedError:
        return dict.fromkeys(texts, 0.0)
    singular, directions = np.linalg.svd(np.array(columns).T, full_matrices=False)[1:]
    variances = ((directions / np.maximum(singular, _REDUNDANT)[:, None]) ** 2).sum(axis=0)
    least: dict[str, float] = {}
    for name, variance in zip(names, variances.tolist(), strict=False):
        least[name] = min(least.get(name, math.inf), 1.0 / math.sqrt(variance))
    return {
        state: min((least[name] for name in CONSTANT.findall(text)), default=math.inf) for state, text in texts.items()
    }


def _constants_changed(runs: Sequence[Run], own: Sequence[str]) -> list[tuple[str, list[Run]]]:
    groups = list(dict.fromkeys(run.group for run in runs))
    changes = []
    for name in runs[0].constants:
        for group in groups if name in own else (None,):
            changed = [
                replace(run, constants={**run.constants, name: run.constants[name] * (1.0 + _SHIFT)})
                if group in (None, run.group)
                else run
                for run in runs
            ]
            changes.append((name, changed))
    return changes


def _starts_changed(texts: Texts, runs: Sequence[Run]) -> list[list[Run]]:
    changes = []
    for number, run in enumerate(runs):
        for place in range(len(texts)):
            start = list(run.start)
            start[place] += _SHIFT * (abs(start[place]) or 1.0)
            changes.append([*runs[:number], replace(run, start=tuple(start)), *runs[number + 1 :]])
    return changes
