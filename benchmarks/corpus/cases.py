"""One job of the corpus: what is measured of one system at one quality, and what a model is judged by."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from atoll_core.errors import AtollError
from benchmarks.corpus.families import NAMED
from benchmarks.corpus.qualities import measure, quality
from benchmarks.corpus.systems import CorpusSystem, draw_family, draw_system, named_system, solution
from benchmarks.harness.solving import DivergedError
from benchmarks.harness.systems import Sampled, table_of
from benchmarks.judging.generalisation import Field
from benchmarks.noise.data import Path

OURS: Final = "atoll"
UNTOLD: Final = "atoll-untold"
"""Ours, not told which functions the law has."""
KNOWN_PART: Final = "atoll-known-part"
"""Ours, given all of the system but one summand of one equation."""
SAMPLINGS: Final = ("even", "uneven", "sparse", "short", "long")
"""Manners of sampling: a grid, random instants, a quarter of the rows, a quarter and four times the duration."""

ROWS: Final = 100
"""Of one of several trajectories; a single one has twice as many."""

FRESH: Final = 4
LEAST_T: Final = 5.0
"""Estimate over standard error of every constant above which an equation is identifiable: about twelve nats."""

_ATTEMPTS: Final = 60
_SHIFT: Final = 1e-4
_PREDICTABLE: Final = 0.99
"""R2 that two true trajectories must have that begin a thousandth of the deviation apart."""


@dataclass(frozen=True, order=True)
class Key:
    """Which job: `system` is the name of one of `NAMED`, or of a family whose constants are drawn from `seed`, or
    ``random``, then drawn from `seed` with `states`.

    `method` is ours or another program's; all have the same data.
    """

    system: str
    states: int
    trajectories: int
    sampling: str
    quality: str
    seed: int
    method: str = OURS

    @property
    def title(self) -> str:
        """The key as people read it."""
        which = f"{self.states}-state" if self.system == "random" else self.system
        many = "" if self.trajectories == 1 else f" x {self.trajectories}"
        other = "" if self.method == OURS else f"{self.method}: "
        sampling = "" if self.sampling == "even" else f"{self.sampling} "
        return f"{other}{which}{many} {sampling}{self.quality} seed {self.seed}"


@dataclass(frozen=True, eq=False)
class Case:
    """What is measured, and what a model is judged by.

    `clean` has the values (R,) without errors by state, `fresh` exact trajectories from the measured box, `t` by state
    the smallest estimate over standard error of a constant that these data allow; `data` are fields of the
    configuration's data section.
    """

    system: CorpusSystem
    table: Table
    clean: Mapping[str, FloatArray]
    fresh: tuple[Path, ...]
    t: Mapping[str, float]
    data: Mapping[str, Any] = field(default_factory=dict)


def make_case(key: Key, *, has_fresh: bool = True) -> Case:
    """Return the data of one job; equal keys give equal data. `has_fresh`: whether fresh trajectories are made."""
    system = system_of(key)
    rng = np.random.default_rng([key.seed, key.states, key.trajectories, SAMPLINGS.index(key.sampling), 2])
    starts, times, clean, measured = _measured(key, system, rng)
    table = table_of(Sampled(system.states, tuple(times), tuple(measured)))
    columns = dict(zip(system.states, np.concatenate(clean).T, strict=True))
    data = {"robust": True} if key.quality.startswith("outliers") else {}
    longest = max(times, key=lambda instants: float(instants[-1]))
    fresh = fresh_paths(system, columns, longest, rng) if has_fresh else ()
    return Case(system, table, columns, fresh, smallest_t(system, starts, times, clean, measured), data)


def with_unknown_summand(system: CorpusSystem, seed: int) -> tuple[str, dict[str, str]]:
    """Return an equation drawn from those with two or more summands, and all equations; in this equation, a question
    mark replaces a summand that is drawn, too."""
    rng = np.random.default_rng([seed, 7])
    truths = {state: _summands(text) for state, text in system.truths.items()}
    state = str(rng.choice([state for state, summands in truths.items() if len(summands) > 1] or list(truths)))
    place = int(rng.integers(len(truths[state])))
    given = dict(system.truths)
    given[state] = " ".join("+ ?" if index == place else summand for index, summand in enumerate(truths[state]))
    return state, given


def _summands(text: str) -> list[str]:
    """Return the summands of a sum, each with its sign in front."""
    level, starts = 0, [0]
    for place, letter in enumerate(text):
        level += (letter == "(") - (letter == ")")
        if level == 0 and place and text[place - 1 : place + 2] in (" + ", " - "):
            starts.append(place)
    parts = [text[first:end].strip() for first, end in zip(starts, [*starts[1:], len(text)], strict=True)]
    return [part if part[0] in "+-" else f"+ {part}" for part in parts]


def system_of(key: Key) -> CorpusSystem:
    """Return the system of a job."""
    if key.system == "random":
        return draw_system(key.seed, key.states)
    return named_system(key.system) if key.system in NAMED else draw_family(key.system, key.seed)


def _measured(
    key: Key, system: CorpusSystem, rng: np.random.Generator
) -> tuple[list[tuple[float, ...]], list[FloatArray], list[FloatArray], list[FloatArray]]:
    """Return initial states, times, exact solutions and what is measured; a coarse solver comes to their ends, too."""
    for _ in range(_ATTEMPTS):
        starts, times, clean = _trajectories(key, system, rng)
        noise_rng = np.random.default_rng([key.seed, key.states, 3])
        try:
            return starts, times, clean, list(measure(quality(key.quality), system, starts, times, clean, noise_rng))
        except DivergedError:
            continue
    raise AtollError(f"{key.title}: the solver of this quality comes to the end of no drawn trajectory; leave it out")


def _trajectories(
    key: Key, system: CorpusSystem, rng: np.random.Generator
) -> tuple[list[tuple[float, ...]], list[FloatArray], list[FloatArray]]:
    """Return initial states, times (n,) and exact solutions (n, S)."""
    starts: list[tuple[float, ...]] = []
    times: list[FloatArray] = []
    clean: list[FloatArray] = []
    fixed = list(system.starts[: key.trajectories])
    while len(starts) < key.trajectories:
        start = fixed.pop(0) if fixed else system.draw_start(rng)
        when = _times(key, system.duration, rng)
        try:
            clean.append(solution(system.field(), start, when))
        except DivergedError:
            continue
        starts.append(start)
        times.append(when)
    return starts, times, clean


def _times(key: Key, duration: float, rng: np.random.Generator) -> FloatArray:
    rows = ROWS if key.trajectories > 1 else 2 * ROWS
    rows = rows // 4 if key.sampling == "sparse" else rows
    duration *= {"short": 0.25, "long": 4.0}.get(key.sampling, 1.0)
    if key.system == "lorenz":
        rows = 1000
    if key.sampling == "uneven":
        return np.array([0.0, *np.sort(rng.uniform(0.0, duration, rows - 1))])
    return np.linspace(0.0, duration, rows)


def fresh_paths(
    system: CorpusSystem, columns: Mapping[str, FloatArray], times: FloatArray, rng: np.random.Generator
) -> tuple[Path, ...]:
    """Return exact trajectories from initial states evenly drawn in the measured box, as long as they are predictable.

    Where small differences of the initial state grow, they are shortened until they hardly do.
    """
    box = [(float(values.min()), float(values.max())) for values in columns.values()]
    deviations = np.array([values.std() for values in columns.values()])
    paths: list[Path] = []
    for _ in range(_ATTEMPTS):
        start = np.array([rng.uniform(low, high) for low, high in box])
        path = _predictable(system, start, 1e-3 * deviations, times)
        if path is not None:
            paths.append(path)
        if len(paths) == FRESH:
            break
    return tuple(paths)


def _predictable(system: CorpusSystem, start: FloatArray, change: FloatArray, times: FloatArray) -> Path | None:
    field = system.field()
    even = np.linspace(0.0, float(times[-1] - times[0]), len(times))
    while even[-1] > 0.01 * (times[-1] - times[0]):
        try:
            states = solution(field, start.tolist(), even)
            near = solution(field, (start + change).tolist(), even)
        except DivergedError:
            return None
        spread = ((states - states.mean(axis=0)) ** 2).sum(axis=0)
        if (((near - states) ** 2).sum(axis=0) <= (1.0 - _PREDICTABLE) * np.maximum(spread, 1e-300)).all():
            return Path(even, states)
        even = 0.5 * even
    return None


def smallest_t(
    system: CorpusSystem,
    starts: Sequence[Sequence[float]],
    times: Sequence[FloatArray],
    clean: Sequence[FloatArray],
    measured: Sequence[FloatArray],
) -> dict[str, float]:
    """Return for each state how well the least known constant of its equation can be known at best.

    The standard errors are those of maximum likelihood to first order, constants and initial states being free, with
    the errors that were made: their size, and fewer rows where they are correlated, (1 - r)/(1 + r) of them.
    """
    names = list(system.constants)
    weights = _weights(clean, measured)
    blocks = []
    for start, when, values in zip(starts, times, clean, strict=True):
        try:
            shifted = [solution(field, state, when) for field, state in _shifted(system, start, values)]
        except DivergedError:
            return dict.fromkeys(system.states, 0.0)
        columns = np.array([(weights * ((states - values) / _SHIFT)).ravel() for states in shifted]).T
        own = columns[:, len(names) :]
        blocks.append(columns[:, : len(names)] - own @ np.linalg.lstsq(own, columns[:, : len(names)], rcond=None)[0])
    stacked = np.concatenate(blocks)
    singular, directions = np.linalg.svd(stacked, full_matrices=False)[1:]
    variances = ((directions / np.maximum(singular, 1e-12)[:, None]) ** 2).sum(axis=0)
    known = dict(zip(names, 1.0 / np.sqrt(variances), strict=True))
    return {
        state: min((float(known[name]) for name in names if re.search(rf"\b{name}\b", text)), default=math.inf)
        for state, text in system.equations.items()
    }


def _weights(clean: Sequence[FloatArray], measured: Sequence[FloatArray]) -> FloatArray:
    """Return for each state the square root of independent rows a row over the deviation of the errors."""
    errors = [left - right for left, right in zip(measured, clean, strict=True)]
    pooled = np.concatenate(errors)
    size = np.sqrt((pooled**2).mean(axis=0))
    products = sum((error[:-1] * error[1:]).sum(axis=0) for error in errors)
    correlation = np.clip(products / np.maximum((pooled**2).sum(axis=0), 1e-300), 0.0, 0.999)
    floor = 1e-12 * np.maximum(np.concatenate(clean).std(axis=0), 1e-300)
    weights: FloatArray = np.sqrt((1.0 - correlation) / (1.0 + correlation)) / np.maximum(size, floor)
    return weights


def _shifted(
    system: CorpusSystem, start: Sequence[float], values: FloatArray
) -> Iterator[tuple[Field, Sequence[float]]]:
    """Yield right-hand sides and initial states, of which one is a little larger: first a constant, then a state."""
    for name, constant in system.constants.items():
        yield system.field({name: constant * (1.0 + _SHIFT)}), start
    for place, state in enumerate(start):
        moved = state + _SHIFT * float(values[:, place].std() or 1.0)
        yield system.field(), [*start[:place], moved, *start[place + 1 :]]
