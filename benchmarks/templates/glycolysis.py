"""Universal differential equations of glycolysis (Philipps et al. 2025, npj Systems Biology and Applications 11:101).

Seven states, of which two are measured; twelve parameters; the degradation of A3 is unknown. A part of the rows up to
the time 1.5 is given, and the states are predicted up to the time 5.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from atoll_core.config import DataConfig, JobConfig, ParameterConfig, PriorConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from benchmarks.harness.jobs import configured, table_of_columns
from benchmarks.harness.solving import DivergedError, solve
from benchmarks.harness.tables import grouped, markdown, share
from benchmarks.judging.generalisation import field_of

STATES: Final = ("S1", "S2", "S3", "S4", "N2", "A3", "S4ex")
START: Final = (1.187, 0.193, 0.05, 0.115, 0.077, 2.475, 0.077)
VALUES: Final[Mapping[str, float]] = {
    "J0": 2.5, "k1": 100.0, "k2": 6.0, "k3": 16.0, "k4": 100.0, "k6": 12.0, "kex": 1.8, "kappa": 13.0, "K1": 0.52,
    "N": 1.0, "A": 4.0, "phi": 0.1,
}  # fmt: skip
BOUNDS: Final = {
    name: (1.0, 1000.0) if name in ("k1", "k4") else (0.01, 10.0) if name in ("K1", "phi") else (0.1, 100.0)
    for name in VALUES
}
_FLUX: Final = "k1*S1*A3/(1 + (A3/K1)**4)"
GIVEN: Final[Mapping[str, str]] = {
    "S1": f"J0 - {_FLUX}",
    "S2": f"2*{_FLUX} - k2*S2*(N - N2) - k6*S2*N2",
    "S3": "k2*S2*(N - N2) - k3*S3*(A - A3)",
    "S4": "k3*S3*(A - A3) - k4*S4*N2 - kappa*(S4 - S4ex)",
    "N2": "k2*S2*(N - N2) - k4*S4*N2 - k6*S2*N2",
    "A3": f"-2*{_FLUX} + 2*k3*S3*(A - A3) + ?(A3)",
    "S4ex": "phi*kappa*(S4 - S4ex) - kex*S4ex",
}
REST: Final = -1.28
END: Final = 5.0
LAST_GIVEN: Final = 1.5
POINTS: Final = (25, 50, 100, 150, 200)
NOISE: Final = (5, 10, 20, 35)
_OSCILLATES: Final = 0.2
"""Least amplitude beyond the given rows, over the true one, that counts as an oscillation."""
RIGHT: Final = 0.05
"""Largest relative error of a right frequency; of a right amplitude it is four times as large."""


@dataclass(frozen=True, order=True)
class GlycolysisKey:
    """One draw: number of points over the whole time, noise in per cent of each observable's mean, seed."""

    points: int
    noise: int
    seed: int

    @property
    def title(self) -> str:
        """The key as people read it."""
        return f"glycolysis, {self.points} points, {self.noise} %, seed {self.seed}"


def truth(times: FloatArray) -> FloatArray:
    """Return the true states (n, S) at these times, the first of which is 0."""
    return states_with({**VALUES, "rest": REST}, times)


def states_with(values: Mapping[str, float], times: FloatArray) -> FloatArray:
    """Return the states (n, S) with these values of the parameters, and of ``rest``, the factor of the unknown part."""

    def filled(match: re.Match[str]) -> str:
        return f"({values[match[0]]!r})" if match[0] in values else match[0]

    sides = [GIVEN[name].replace("?(A3)", "rest*A3") for name in STATES]
    return _solved([re.sub(r"[A-Za-z_]\w*", filled, side) for side in sides], times)


def _solved(expressions: list[str], times: FloatArray) -> FloatArray:
    field = field_of(expressions, STATES)
    return solve(
        lambda state: field(state.tolist()), START, times, limit=1e6, most_evaluations=200_000, method="LSODA",
        rtol=1e-8, atol=1e-10,
    )  # fmt: skip


def request_of(key: GlycolysisKey) -> tuple[Table, JobConfig]:
    """Return the table of one draw, and the job."""
    times = np.linspace(0.0, END, key.points)
    states = truth(times)
    rng = np.random.default_rng([key.points, key.noise, key.seed])
    columns: dict[str, FloatArray] = {"t": times}
    for name in ("N2", "A3"):
        values = states[:, STATES.index(name)]
        noisy = values + 0.01 * key.noise * float(values.mean()) * rng.standard_normal(len(values))
        columns[name] = np.maximum(noisy, 1e-10)
    given = times <= LAST_GIVEN
    table = table_of_columns({name: values[given] for name, values in columns.items()}, "glycolysis.csv")
    prior = PriorConfig(
        equations=dict(GIVEN),
        parameters={name: ParameterConfig(lower=low, upper=high) for name, (low, high) in BOUNDS.items()},
        initial={name: ParameterConfig(start=value) for name, value in zip(STATES, START, strict=True)},
        limits={"A3": ("A3 -> 0: 0",)},  # without A3, nothing is degraded
    )
    hidden = tuple(name for name in STATES if name not in ("N2", "A3"))
    config = configured(key.seed)
    data = DataConfig(hidden=hidden)
    return table, config.model_copy(update={"prior": prior, "data": data})


@dataclass(frozen=True)
class GlycolysisOutcome:
    """How one draw came out.

    `frequency` and `amplitude` are relative errors of A3 beyond the given rows (None: no oscillation). `rest` is the
    unknown part, `factor` its coefficient k if it is k*A3, and `is_covered` whether its interval holds the truth.
    """

    key: GlycolysisKey
    oscillates: bool
    frequency: float | None
    amplitude: float | None
    rest: str | None
    factor: float | None
    is_covered: bool | None
    grade: str | None
    seconds: float
    failure: str | None = None

    @property
    def has_right_frequency(self) -> bool:
        """Whether the frequency is right within 5 %."""
        return self.frequency is not None and abs(self.frequency) <= RIGHT

    @property
    def has_right_amplitude(self) -> bool:
        """Whether the amplitude is right within 20 %."""
        return self.amplitude is not None and abs(self.amplitude) <= 4.0 * RIGHT


def judge(key: GlycolysisKey, result: Mapping[str, Any], seconds: float, failure: str | None) -> GlycolysisOutcome:
    """Return how the result of one draw came out."""
    equations = {one["variable"]: one for one in result.get("equations", ())}
    texts = [equations.get(name, {}).get("expression") for name in STATES]
    of_a3 = equations.get("A3", {})
    oscillates, frequency, amplitude = _judge_oscillation(texts)
    unknowns = (of_a3.get("given") or {}).get("unknowns") or [{}]
    rest = unknowns[0].get("expression")
    implied = [one for one in of_a3.get("implied") or () if one.get("of") == "A3"]
    factor, is_covered = _factor(rest, of_a3.get("constants") or (), implied)
    return GlycolysisOutcome(
        key, oscillates, frequency, amplitude, rest, factor, is_covered, of_a3.get("verdict"), seconds, failure
    )


def _judge_oscillation(texts: list[str | None]) -> tuple[bool, float | None, float | None]:
    """Return whether A3 oscillates beyond the given rows, and the relative errors of frequency and amplitude."""
    times = np.linspace(0.0, END, 2001)
    beyond = times > LAST_GIVEN
    right = truth(times)[beyond, STATES.index("A3")]
    known = [text for text in texts if text is not None]
    if len(known) < len(texts):
        return False, None, None
    try:
        found = _solved(known, times)[beyond, STATES.index("A3")]
    except DivergedError:
        return False, None, None
    own, true = period(times[beyond], found), period(times[beyond], right)
    late = slice(len(found) // 2, None)
    ratio = float(found[late].std() / right[late].std())
    if own is None or true is None or ratio < _OSCILLATES:
        return False, None, None
    return True, true / own - 1.0, ratio - 1.0


def period(times: FloatArray, values: FloatArray) -> float | None:
    """Return the mean time between rises through the mean; None if there are fewer than three."""
    above = values - values.mean()
    before = np.flatnonzero((above[:-1] <= 0.0) & (above[1:] > 0.0))
    if len(before) < 3:
        return None
    shares = above[before] / (above[before] - above[before + 1])
    rises = times[before] + shares * (times[before + 1] - times[before])
    return float((rises[-1] - rises[0]) / (len(rises) - 1))


def _factor(
    rest: str | None, constants: Sequence[Mapping[str, Any]], implied: Sequence[Mapping[str, Any]]
) -> tuple[float | None, bool | None]:
    """Return the factor k of a rest k*A3, and whether its interval holds the truth; None if the rest has another form.

    `implied` are factors of one that are not written.
    """
    values = np.array([0.5, 1.0, 2.0])
    if rest is None:
        return None, None
    field = field_of([rest], STATES)
    try:
        found = np.array([field([1.0, 1.0, 1.0, 1.0, 1.0, value, 1.0])[0] for value in values])
    except (ArithmeticError, ValueError):
        return None, None
    factors = found / values
    if not np.allclose(factors, factors[0], rtol=1e-9):
        return None, None
    factor = float(factors[0])
    fitted = [one for one in constants if one.get("interval") and abs(abs(one["value"]) - abs(factor)) < 1e-9]
    interval = next((one["interval"] for one in (*fitted, *implied) if one.get("interval")), None)
    if interval is None or None in interval:
        return factor, None
    # a constant is written with or without the sign of its term
    low, high = sorted(interval if sum(interval) * factor > 0.0 else [-end for end in interval])
    return factor, bool(low <= REST <= high)


def line(outcome: GlycolysisOutcome) -> str:
    """Return how one draw came out, for following a long run."""
    frequency = "-" if outcome.frequency is None else f"{100.0 * outcome.frequency:+.1f} %"
    return (
        f"{outcome.key.title}: frequency {frequency}, rest {outcome.rest}, covers {outcome.is_covered}, "
        f"{outcome.grade}; {outcome.seconds:.1f} s{'; ' + outcome.failure if outcome.failure else ''}"
    )


def table_of(outcomes: Sequence[GlycolysisOutcome]) -> str:
    """Return the table of all cells, in Markdown, and the counts of the published table."""
    rows = []
    for (points, noise), chosen in grouped(outcomes, lambda one: (one.key.points, one.key.noise)).items():
        rows.append((
            str(points), f"{noise} %", share(sum(one.oscillates for one in chosen), len(chosen)),
            share(sum(one.has_right_frequency for one in chosen), len(chosen)),
            share(sum(one.has_right_amplitude for one in chosen), len(chosen)),
            share(sum(one.factor is not None for one in chosen), len(chosen)),
            share(sum(bool(one.is_covered) for one in chosen), len(chosen)),
            share(sum(one.grade in ("exact", "good") for one in chosen), len(chosen)),
            f"{np.median([one.seconds for one in chosen]):.1f}",
        ))  # fmt: skip
    cells = grouped(outcomes, lambda one: (one.key.points, one.key.noise)).values()
    right = sum(sum(one.has_right_frequency for one in chosen) >= 0.6 * len(chosen) for chosen in cells)
    covered = sum(sum(bool(one.is_covered) for one in chosen) >= 0.6 * len(chosen) for chosen in cells)
    heads = (
        "points", "noise", "oscillates", "right frequency", "right amplitude", "rest is k*A3", "interval holds",
        "good", "median s",
    )  # fmt: skip
    counts = f"cells with six of ten right in frequency: {right} of {len(cells)}; with the rest covered: {covered}"
    return f"{markdown(heads, rows)}\n\n{counts}"
