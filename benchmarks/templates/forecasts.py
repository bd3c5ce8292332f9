"""Systems with a state that no column measures: the end of a trajectory is held out and forecast in open loop.

``one column``: oscillators of second and third order, the van der Pol oscillator and the Lotka-Volterra equations, of
which one column is given, searched with ``--hidden 1`` or ``--hidden 2``. ``tanks``: cascaded tanks (Schoukens & Noël
2016, nonlinearbenchmark.org): the voltage of a pump is given, and the level of the lower tank is measured; of the 1,024
rows of the file for estimation the first 768 are given. They are searched with ``--hidden 1``, and with templates of
two tanks: with unknown outflows, with an unknown lower tank, and with square roots as outflows, also with an overflow,
where only numbers are fitted. ``emps``: an electro-mechanical positioning system (Janot, Gautier & Brunot 2019,
nonlinearbenchmark.org): the force signal is given and the position is measured; the friction is unknown, and the
velocity is a hidden state. Of the 4,969 rows of the file the first 3,726 are given. A forecast begins at the simulated
state of the last given row and uses no measured state after it.
"""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from atoll_core.config import DataConfig, JobConfig, ParameterConfig, PriorConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from atoll_core.errors import UsageError
from benchmarks.harness.jobs import configured, table_of_columns
from benchmarks.harness.solving import DivergedError, solve
from benchmarks.harness.tables import markdown
from benchmarks.judging.generalisation import field_of

_GIVEN: Final = 0.75
"""Share of the rows that is given."""
_FULL: Final = 10.0
"""Volts of the sensor at a full tank; higher forecasts count as full."""
TANKS: Final = "cascaded_tanks_train.csv"
BY_NUMBER: Final = "--hidden 1"
TANK_TEMPLATES: Final[Mapping[str, tuple[Mapping[str, str], Mapping[str, tuple[float, float]]]]] = {
    "template": ({"h": "k*u - ?1(h)", "y": "?1(h) - ?2(y)"}, {"k": (0.005, 1.0)}),
    "template, lower tank unknown": ({"h": "k*u - ?1(h)", "y": "?2(h,u,y)"}, {"k": (0.005, 1.0)}),
    "square roots given": (
        {"h": "k*u - a*sqrt(h)", "y": "a*sqrt(h) - b*sqrt(y - c)"},
        {"k": (0.005, 1.0), "a": (0.005, 1.0), "b": (0.005, 1.0), "c": (-5.0, 2.5)},
    ),
    "square roots and overflow given": (
        {
            "h": "k*u - a*sqrt(h) - s*(h - m + abs(h - m))",
            "y": "a*sqrt(h) + r*s*(h - m + abs(h - m)) - b*sqrt(y - c)",
        },
        {
            "k": (0.005, 1.0),
            "a": (0.005, 1.0),
            "b": (0.005, 1.0),
            "c": (-5.0, 2.5),
            "s": (0.01, 10.0),
            "m": (1.0, 30.0),
            "r": (0.1, 2.0),
        },
    ),
}
"""Ways to search the tanks with given equations: their sides, and the bounds of their parameters."""
TANK_WAYS: Final = (BY_NUMBER, *TANK_TEMPLATES)
EMPS: Final = "emps_train.csv"
EMPS_WAYS: Final = ("emps", "emps, + - * / abs tanh")
"""The drive with the default operators, and with those that friction may need."""
ONE_COLUMN: Final[Mapping[str, tuple[Mapping[str, str], tuple[float, ...], float, int]]] = {
    "damped oscillator": ({"x": "v", "v": "-4*x - 0.3*v"}, (1.0, 0.0), 12.0, 300),
    "van der Pol": ({"x": "v", "v": "1.2*(1 - x*x)*v - x"}, (0.5, 0.0), 26.0, 520),
    "Lotka-Volterra": ({"x": "x - 0.5*x*y", "y": "0.3*x*y - 0.8*y"}, (2.0, 1.0), 32.0, 520),
    "oscillator of third order": ({"x": "v", "v": "a", "a": "-0.4*a - 2*v - 0.6*x"}, (1.0, 0.0, 0.5), 26.0, 520),
}
"""Right-hand sides, initial state, duration and rows; the first state is measured, and the others are hidden."""


@dataclass(frozen=True, order=True)
class ForecastKey:
    """One job: system or way to search the tanks, noise in per cent of the column's standard deviation, seed."""

    system: str
    noise: int
    seed: int

    @property
    def title(self) -> str:
        """The key as people read it."""
        return f"{self.system}, {self.noise} %, seed {self.seed}"


@dataclass(frozen=True, eq=False)
class Case:
    """All rows of one system: `times` (n,), the `measured` column (n,), the `truth` (n,) that forecasts are compared
    with, and the inputs (n,) by name. The first `given` rows are searched. The measured `column` is at most `most`."""

    times: FloatArray
    measured: FloatArray
    truth: FloatArray
    inputs: Mapping[str, FloatArray]
    column: str = "x"
    most: float = np.inf

    @property
    def given(self) -> int:
        """Number of the given rows."""
        return int(_GIVEN * len(self.times))


def case_of(key: ForecastKey, data: Path | None) -> Case:
    """Return all rows of one job; `data` is the folder of the file of the tanks."""
    if key.system in ONE_COLUMN:
        truths, start, duration, rows = ONE_COLUMN[key.system]
        times = np.linspace(0.0, duration, rows)
        field = field_of(list(truths.values()), list(truths))
        options: dict[str, Any] = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-13}
        states = solve(lambda x: field(x.tolist()), start, times, limit=1e8, most_evaluations=200_000, **options)
        truth = states[:, 0]
        errors = np.random.default_rng([key.noise, key.seed]).standard_normal(rows)
        return Case(times, truth + 0.01 * key.noise * truth.std() * errors, truth, {})
    file_name, column, most = (EMPS, "q", np.inf) if key.system in EMPS_WAYS else (TANKS, "y", _FULL)
    if data is None:
        raise UsageError(f"give the folder of {file_name} with --data")
    with (data / file_name).open(encoding="utf-8") as file:
        rows_of_file = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
    columns = {name: np.array([row[name] for row in rows_of_file]) for name in ("t", "u", column)}
    return Case(columns["t"], columns[column], columns[column], {"u": columns["u"]}, column, most)


def request_of(key: ForecastKey, case: Case) -> tuple[Table, JobConfig]:
    """Return the table of one job and its configuration."""
    columns = {"t": case.times, **case.inputs, case.column: case.measured}
    table = table_of_columns({column: values[: case.given] for column, values in columns.items()}, f"{key.system}.csv")
    inputs = tuple(case.inputs)
    if key.system in EMPS_WAYS:
        return table, _with_known_part(key, inputs)
    if key.system not in TANK_TEMPLATES:
        hidden = len(ONE_COLUMN[key.system][0]) - 1 if key.system in ONE_COLUMN else 1
        return table, configured(key.seed, {"hidden": (str(hidden),), "inputs": inputs})
    config = configured(key.seed, operators=("+", "-", "*", "/", "sqrt"))
    sides, bounds = TANK_TEMPLATES[key.system]
    prior = PriorConfig(
        equations=dict(sides),
        parameters={name: ParameterConfig(lower=lower, upper=upper) for name, (lower, upper) in bounds.items()},
        initial={"h": ParameterConfig(lower=0.0, upper=20.0)},
    )
    return table, config.model_copy(update={"prior": prior, "data": DataConfig(hidden=("h",), inputs=inputs)})


def _with_known_part(key: ForecastKey, inputs: tuple[str, ...]) -> JobConfig:
    """Return the job of the drive: the force signal accelerates it, and the rest depends on the velocity."""
    config = configured(key.seed, operators=key.system.split(" ")[1:] or None)
    prior = PriorConfig(
        equations={"q": "v", "v": "a*u + ?(v)"},
        parameters={"a": ParameterConfig(lower=0.1, upper=10.0)},
        initial={"v": ParameterConfig(lower=-2.0, upper=2.0)},
    )
    return config.model_copy(update={"prior": prior, "data": DataConfig(hidden=("v",), inputs=inputs)})


@dataclass(frozen=True)
class ForecastOutcome:
    """How one job came out: R2 and root mean squared error of the forecast (None: it ran away or there is none)."""

    key: ForecastKey
    r2: float | None
    error: float | None
    equations: Mapping[str, str]
    grades: Mapping[str, str | None]
    seconds: float
    failure: str | None = None


def judge(
    key: ForecastKey, case: Case, result: Mapping[str, Any], seconds: float, failure: str | None = None
) -> ForecastOutcome:
    """Return how the result of one job came out."""
    parts = result.get("equations", ())
    equations = {part["variable"]: part["expression"] for part in parts}
    grades = {part["variable"]: part.get("verdict") for part in parts}
    forecast = _forecast(case, result, equations)
    if forecast is None:
        return ForecastOutcome(key, None, None, equations, grades, seconds, failure)
    truth = case.truth[case.given :]
    square = float(np.mean((forecast - truth) ** 2))
    return ForecastOutcome(
        key, 1.0 - square / float(truth.var()), square**0.5, equations, grades, seconds, failure
    )  # fmt: skip


def _forecast(case: Case, result: Mapping[str, Any], equations: Mapping[str, str]) -> FloatArray | None:
    """Return the measured column at the rows that were held out; None if it runs away or nothing was simulated."""
    listed = (result.get("simulation") or {}).get("trajectories") or []
    if not listed or not equations:
        return None
    last, states, inputs = listed[-1], list(equations), list(case.inputs)
    start = [float(last["values"][name][-1]) for name in states]
    field = field_of(list(equations.values()), [*states, *inputs])
    times = case.times[case.given :]
    values = np.zeros(len(times))
    before, state = float(last["times"][-1]), np.array(start)
    measured = states.index(case.column)
    for place, time in enumerate(times.tolist()):
        here = [(float(np.interp(before, case.times, one)), float(np.interp(time, case.times, one)))
                for one in case.inputs.values()]  # fmt: skip
        span = time - before

        def rates(moment: float, now: FloatArray, here: Sequence[tuple[float, float]] = here,
                  begin: float = before, span: float = span) -> list[float]:  # fmt: skip
            share = (moment - begin) / span
            return field([*now.tolist(), *(first + share * (end - first) for first, end in here)])

        try:
            state = _advance(rates, state, before, time)
        except (DivergedError, ArithmeticError, ValueError):
            return None
        before, values[place] = time, state[measured]
    return np.minimum(values, case.most)


def _advance(rates: Any, state: FloatArray, begin: float, end: float, steps: int = 8) -> FloatArray:
    """Return the state at the time `end`, by the classical Runge-Kutta method."""
    size = (end - begin) / steps
    for step in range(steps):
        time = begin + step * size
        first = np.array(rates(time, state))
        second = np.array(rates(time + 0.5 * size, state + 0.5 * size * first))
        third = np.array(rates(time + 0.5 * size, state + 0.5 * size * second))
        fourth = np.array(rates(time + size, state + size * third))
        state = state + size / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
        if not (np.abs(state) < 1e8).all():
            raise DivergedError
    return state


def line(outcome: ForecastOutcome) -> str:
    """Return how one job came out, for following a long run."""
    r2, error = ("-" if one is None else f"{one:.4f}" for one in (outcome.r2, outcome.error))
    failure = f"; {outcome.failure}" if outcome.failure else ""
    return (
        f"{outcome.key.title}: R2 {r2}, RMSE {error}, {dict(outcome.equations)}, {dict(outcome.grades)}; "
        f"{outcome.seconds:.1f} s{failure}"
    )


def table_of(outcomes: Sequence[ForecastOutcome]) -> str:
    """Return the table of all jobs, in Markdown."""
    rows = [
        (
            one.key.system, f"{one.key.noise} %", str(one.key.seed), "-" if one.r2 is None else f"{one.r2:.4f}",
            "-" if one.error is None else f"{one.error:.3f}",
            ", ".join(f"{name}: {grade}" for name, grade in one.grades.items()), f"{one.seconds:.0f}",
        )
        for one in outcomes
    ]  # fmt: skip
    return markdown(("job", "noise", "seed", "R2 of the forecast", "RMSE", "verdicts", "s"), rows)
