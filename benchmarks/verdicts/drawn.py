"""One table that was drawn: what is in the file, the words on the command line, and what is true of it."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, TypeVar

import numpy as np

from atoll_core.data.dataset import FloatArray
from benchmarks.corpus.cases import LEAST_T
from benchmarks.first_hour.cases import FEWEST_ROWS
from benchmarks.first_hour.tables import Columns
from benchmarks.harness.solving import DivergedError
from benchmarks.verdicts.identification import Measurements, leads
from benchmarks.verdicts.simulation import Run, Texts, least_t, prediction_r2, simulate, with_numbers

Laws = Mapping[str, str | None]
"""Right-hand sides by variable of an equation, None for one that has no law."""

Predictions = Mapping[str, tuple[float, float]]
"""R² by variable from other initial states, and beyond what was measured: twice as long, or at other x values. It is
-inf where a model cannot be simulated, nan where nothing is to be judged by."""

Predict = Callable[[Mapping[str, Mapping[str, str | None]]], Predictions]
"""R² of models by group."""

Value = TypeVar("Value")

FRESH: Final = 4
"""Runs from other initial states by which a model is judged."""


@dataclass(frozen=True, eq=False)
class Drawn:
    """One table. `columns` are what the file has, in its order; `texts` are columns of words, written before these.

    `laws` has the laws by group, "" where there are no groups, over the names of `clean`: the columns (R,) without
    errors, with velocities where these are sought. `identify` computes `t`, `decide` the leads, `predict` is None where
    nothing can be predicted.
    """

    kind: str
    columns: Columns
    words: tuple[str, ...]
    laws: Mapping[str, Laws]
    clean: Columns = field(default_factory=dict)
    identify: Callable[[], Mapping[str, float]] = dict
    predict: Predict | None = None
    texts: Mapping[str, Sequence[str]] = field(default_factory=dict)
    decide: Callable[[], Mapping[str, float]] | None = None

    @cached_property
    def t(self) -> Mapping[str, float]:
        """Estimate over standard error of the least known constant of each equation, by variable."""
        return self.identify()

    @cached_property
    def leads(self) -> Mapping[str, float] | None:
        """Nats by which each law describes the rows better than other textbook forms, None where that is not sought."""
        return None if self.decide is None else self.decide()

    @property
    def rows(self) -> int:
        """Rows of the table."""
        return len(next(iter(self.columns.values())))

    @property
    def runs(self) -> int:
        """Runs of the table; 0 where rows have no time."""
        return 0 if "--target" in self.words else len(set(self.texts["run"])) if "run" in self.texts else 1

    def is_identified(self, variable: str) -> bool:
        """Whether the data tell the law from shorter ones: enough rows, and no constant that may be zero."""
        return self.rows >= FEWEST_ROWS and self.t.get(variable, 0.0) >= LEAST_T

    def csv(self) -> str:
        """Return the text of the file."""
        lists = [*self.texts.values(), *(map(_cell, values.tolist()) for values in self.columns.values())]
        rows = [",".join(row) for row in zip(*lists, strict=True)]
        return "\n".join([",".join((*self.texts, *self.columns)), *rows]) + "\n"


def _cell(value: float) -> str:
    return str(int(value)) if value.is_integer() and abs(value) < 1e15 else f"{value:.12g}"


def rounded(values: FloatArray, digits: int) -> tuple[FloatArray, float]:
    """Return values with as many decimals as give the largest one `digits`, and the deviation of the errors."""
    largest = float(np.abs(values).max()) or 1.0
    decimals = digits - 1 - math.floor(math.log10(largest))
    return np.round(values, decimals) + 0.0, 10.0**-decimals / math.sqrt(12.0)


def with_errors(
    clean: Sequence[FloatArray], share: float, digits: int | None, rng: np.random.Generator
) -> tuple[list[FloatArray], FloatArray]:
    """Return states (n, S) with normal errors and as they are written, and the deviations (S,) of all errors.

    Errors are `share` of each state's deviation over all runs; digits: None for all that a number has.
    """
    spread = share * np.concatenate(clean).std(axis=0)
    noisy = [states + spread * rng.standard_normal(states.shape) for states in clean]
    if digits is None:
        return noisy, np.maximum(spread, 1e-12)
    stacked = np.concatenate(noisy)
    written, steps = zip(*(rounded(values, digits) for values in stacked.T), strict=True)
    ends = np.cumsum([len(states) for states in clean])[:-1]
    return np.split(np.array(written).T, ends), np.sqrt(spread**2 + np.square(steps))


def nice_step(value: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above a value."""
    power = 10.0 ** math.floor(math.log10(value))
    return float(f"{max(one for one in (1.0, 2.0, 5.0) if one * power <= value * (1.0 + 1e-9)) * power:.3g}")


@dataclass(frozen=True, eq=False)
class Measured:
    """Runs of one law, and the fresh ones by which a model of them is judged.

    `texts` has the law over names of constants; `states` those that are written in the file; with `order` 2 the second
    half of the texts are velocities, and equations are sought for the positions.
    """

    texts: Texts
    runs: Sequence[Run]
    fresh: Sequence[Run]
    states: tuple[str, ...]
    own: tuple[str, ...] = ()
    order: int = 1

    def solutions(self) -> list[FloatArray]:
        """Return the states (n, S) of each run; raises DivergedError."""
        return [simulate(with_numbers(self.texts, run.constants), run) for run in self.runs]

    def clean(self, solutions: Sequence[FloatArray]) -> Columns:
        """Return all states and inputs (R,) without errors."""
        columns = dict(zip(self.texts, np.concatenate(solutions).T, strict=True))
        inputs = {
            name: np.array([run.inputs[name](time) for run in self.runs for time in run.times.tolist()])
            for name in self.runs[0].inputs
        }
        return {**columns, **inputs}

    def laws(self) -> dict[str, Laws]:
        """Return the laws with numbers by group and by variable of an equation."""
        return {run.group: self._by_variable(with_numbers(self.texts, run.constants)) for run in self.runs}

    def _by_variable(self, states: Mapping[str, Value]) -> dict[str, Value]:
        """Return what belongs to states by the variables whose equations theirs are."""
        named = {self._variable(state): value for state, value in states.items()}
        return {variable: value for variable, value in named.items() if variable}

    def _variable(self, state: str) -> str:
        """Return the variable whose equation a state's is, "" where it is none that is sought."""
        if self.order == 1:
            return state
        return state.removesuffix("_dot") if state.endswith("_dot") else ""

    def t(self, errors: FloatArray) -> dict[str, float]:
        """Return by variable how well the least known constant can be known with errors of the states in the file."""
        least = least_t(self.texts, self.runs, dict(zip(self.states, errors.tolist(), strict=True)), self.own)
        return self._by_variable(least)

    def leads(self, columns: Columns, errors: FloatArray) -> dict[str, float]:
        """Return by variable how many nats better its law describes the only run's columns than other textbook forms.

        A law without rivals leads by infinitely many.
        """
        (run,), (clean,) = self.runs, self.solutions()
        values = {state: columns[state] for state in self.states}
        measured = Measurements(values, dict(zip(self.states, errors.tolist(), strict=True)))
        found = leads(self.texts, run, clean, measured)
        return self._by_variable({state: found.get(state, math.inf) for state in self.texts})

    def predict(self, models: Mapping[str, Mapping[str, str | None]]) -> Predictions:
        """Return R² by variable along the fresh runs, and along the same ones lasting twice as long."""
        whole = {group: self._whole(model) for group, model in models.items()}
        return {
            variable: (near, far)
            for (variable, near), far in zip(
                self._r2(whole, self.fresh).items(),
                self._r2(whole, [_longer(run) for run in self.fresh]).values(),
                strict=True,
            )
        }

    def _r2(self, whole: Mapping[str, Texts], runs: Sequence[Run]) -> dict[str, float]:
        if any(not text for model in whole.values() for text in model.values()):
            return self._by_variable(dict.fromkeys(self.texts, -math.inf))
        try:
            true = [simulate(with_numbers(self.texts, run.constants), run) for run in runs]
        except DivergedError:
            return self._by_variable(dict.fromkeys(self.texts, math.nan))
        r2 = prediction_r2(whole, runs, true)
        return r2 if self.order == 1 else {variable: r2[variable] for variable in self._by_variable(r2)}

    def _whole(self, model: Mapping[str, str | None]) -> dict[str, str]:
        if self.order == 1:
            return {state: model.get(state) or "" for state in self.texts}
        return {
            state: (model.get(self._variable(state)) or "") if state.endswith("_dot") else f"{state}_dot"
            for state in self.texts
        }


def _longer(run: Run) -> Run:
    """Return the run, lasting twice as long."""
    times = run.times
    return replace(run, times=np.concatenate([times, times[-1] + (times[1:] - times[0])]))
