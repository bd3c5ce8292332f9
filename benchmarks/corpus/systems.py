"""One system drawn from a seed, and its exact solutions.

A drawn system is plausible: from random initial states its solutions stay finite and moderate, vary, are resolved by
a hundred points, and every constant has an effect on the derivatives that no combination of the others has.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import count
from typing import Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import Program
from atoll_core.expression.text.parsing import from_infix
from benchmarks.corpus.families import FAMILIES, NAMED, WITH_FUNCTIONS, Box, Family
from benchmarks.corpus.random_equations import random_family
from benchmarks.harness.solving import DivergedError, solve
from benchmarks.judging.generalisation import Field, field_of

SIMPLE: Final = (0.1, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.75, 0.8, 1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 8.0, 10.0, 20.0)
TRIALS: Final = 4
"""Trajectories on which a system is tried."""

POINTS: Final = 100
MOST_EVALUATIONS: Final = 40_000
MOST_ATTEMPTS: Final = 300
"""Random equations that are tried before the system of a seed is taken from a textbook."""

LARGEST: Final = 1e4
LEAST_EFFECT: Final = 0.02
"""Of a constant: what the other constants cannot take over of its effect, over the derivative's deviation."""

LARGEST_STEP: Final = 0.25
"""Of a state between two of `POINTS` times, over its range."""

LEAST_STEP: Final = 1e-3
LEAST_MOVING: Final = 0.5
"""Share of the rows in which some state moves by more than `LEAST_STEP` of its range; else the duration is halved."""

OPERATORS: Final = ("exp", "log", "sqrt", "abs", "tanh")
"""Functions that are not among the operators of the default search."""

_CONSTANT: Final = re.compile(r"\bk\d+\b")


@dataclass(frozen=True)
class CorpusSystem:
    """Right-hand sides by state over names of constants, their values, where trajectories begin, and how long they are.

    `starts` are initial states that are fixed; further ones are drawn from `box`.
    """

    name: str
    equations: Mapping[str, str]
    constants: Mapping[str, float]
    box: tuple[tuple[float, float], ...]
    duration: float
    starts: tuple[tuple[float, ...], ...] = ()

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states."""
        return tuple(self.equations)

    @property
    def truths(self) -> dict[str, str]:
        """Right-hand sides with numbers, by state."""
        return {state: self._with_numbers(text) for state, text in self.equations.items()}

    @property
    def operators(self) -> tuple[str, ...]:
        """Functions that a search needs beside the default ones."""
        text = " ".join(self.equations.values())
        functions = [name for name in OPERATORS if f"{name}(" in text]
        return (*functions, *(["pow"] if "**k" in text else []))

    def field(self, changes: Mapping[str, float] | None = None) -> Field:
        """Return the right-hand sides as a function of the states, some constants with other values."""
        other = CorpusSystem(self.name, self.equations, {**self.constants, **(changes or {})}, self.box, self.duration)
        return field_of(list(other.truths.values()), self.states)

    def draw_start(self, rng: np.random.Generator) -> tuple[float, ...]:
        """Return an initial state from the box."""
        return tuple(float(rng.uniform(low, high)) for low, high in self.box)

    def _with_numbers(self, text: str) -> str:
        return _CONSTANT.sub(lambda match: repr(self.constants[match[0]]), text)


def solution(
    field: Field, start: Sequence[float], times: FloatArray, method: str = "DOP853", rtol: float = 1e-11,
    atol: float = 1e-13,
) -> FloatArray:  # fmt: skip
    """Return the states (n, S) from `start` at `times` (n,), of which the first is 0; raises DivergedError."""
    return solve(
        lambda state: field(state.tolist()), start, times, limit=LARGEST, most_evaluations=MOST_EVALUATIONS,
        method=method, rtol=rtol, atol=atol,
    )  # fmt: skip


def named_system(name: str) -> CorpusSystem:
    """Return one of the single systems of `NAMED`."""
    family, constants, start, duration = NAMED[name]
    box = tuple((0.5 * value, 1.5 * value) if value else (-1.0, 1.0) for value in start)
    return CorpusSystem(name, family.equations, constants, box, duration, (start,))


@lru_cache(maxsize=256)
def draw_system(seed: int, states: int) -> CorpusSystem:
    """Return the system of a seed with so many states; half of them from textbooks where there are any."""
    rng = np.random.default_rng([seed, states, 1])
    families = [name for name, family in FAMILIES.items() if len(family.equations) == states]
    is_known = rng.random() < 0.5
    for attempt in count():
        if attempt == MOST_ATTEMPTS:
            is_known = True
        name = families[int(rng.integers(len(families)))] if is_known else "random"
        family = FAMILIES[name] if is_known else random_family(rng, states)
        system = _plausible(name, family, rng)
        if system is not None:
            return system
    raise AssertionError("count() does not end")


@lru_cache(maxsize=256)
def draw_family(name: str, seed: int) -> CorpusSystem:
    """Return a system of a family with the constants of a seed; raises UsageError where none is plausible."""
    family = (FAMILIES | WITH_FUNCTIONS)[name]
    rng = np.random.default_rng([seed, len(family.equations), 5])
    systems = (_plausible(name, family, rng) for _ in range(MOST_ATTEMPTS))
    system = next((system for system in systems if system is not None), None)
    if system is None:
        raise UsageError(f"no constants of the family {name!r} that seed {seed} draws give plausible solutions")
    return system


def _plausible(name: str, family: Family, rng: np.random.Generator) -> CorpusSystem | None:
    is_simple = rng.random() < 0.5
    constants = {key: _constant(rng, low, high, is_simple) for key, (low, high) in family.constants.items()}
    box = tuple(_scaled(side, constants) for side in family.box)
    system = CorpusSystem(name, family.equations, constants, box, 1.0)
    field = system.field()
    starts = [system.draw_start(rng) for _ in range(TRIALS)]
    spread = float(rng.uniform(6.0, 25.0))
    try:
        duration = _rounded(spread * _time_unit(system, field, starts))
        runs = _solved(field, starts, duration)
        while not _is_moving(runs):
            duration = _rounded(0.5 * duration)
            runs = _solved(field, starts, duration)
    except (DivergedError, ValueError):  # it runs away, or rests however short the duration
        return None
    system = CorpusSystem(name, family.equations, constants, box, duration)
    return system if _is_lively(runs) and _matter(system, np.concatenate(runs)) else None


def _constant(rng: np.random.Generator, low: float, high: float, is_simple: bool) -> float:
    value = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    if is_simple:
        allowed = [simple for simple in SIMPLE if low <= simple <= high]
        if allowed:
            return min(allowed, key=lambda simple: abs(np.log(simple / value)))
    return float(f"{value:.3g}")


def _scaled(box: Box, constants: Mapping[str, float]) -> tuple[float, float]:
    low, high, unit = box
    factor = constants[unit] if unit else 1.0
    return low * factor, high * factor


def _rounded(value: float) -> float:
    return float(f"{value:.2g}")


def _time_unit(system: CorpusSystem, field: Field, starts: Sequence[Sequence[float]]) -> float:
    """Return the time in which the fastest state changes by its deviation, from solutions of a guessed length."""
    widths = [high - low for low, high in system.box]
    rates = [abs(slope) / width for start in starts for slope, width in zip(_safe(field, start), widths, strict=True)]
    length = 5.0 / max(float(np.median(rates)), 1e-6)
    runs = [solution(field, start, np.linspace(0.0, length, POINTS), rtol=1e-6, atol=1e-8) for start in starts]
    slopes = np.array([_safe(field, state) for run in runs for state in run.tolist()])
    deviations = np.concatenate(runs).std(axis=0)
    return float(np.min(deviations / np.maximum(np.sqrt((slopes**2).mean(axis=0)), 1e-12)))


def _safe(field: Field, state: Sequence[float]) -> list[float]:
    try:
        return field(state)
    except (ArithmeticError, ValueError) as error:
        raise DivergedError from error


def _solved(field: Field, starts: Sequence[Sequence[float]], duration: float) -> list[FloatArray]:
    times = np.linspace(0.0, duration, POINTS)
    return [solution(field, start, times) for start in starts]


def _is_moving(runs: Sequence[FloatArray]) -> bool:
    """Tell whether some state moves in most rows; a system that only rests has no duration that is too long."""
    steps = np.abs(np.concatenate([np.diff(run, axis=0) for run in runs]))
    extent = np.ptp(np.concatenate(runs), axis=0)
    return bool((steps > LEAST_STEP * extent).any(axis=1).mean() >= LEAST_MOVING) or not extent.all()


def _is_lively(runs: Sequence[FloatArray]) -> bool:
    """Tell whether all states vary, and by no more than a share of their range between two points."""
    values = np.concatenate(runs)
    extent = np.ptp(values, axis=0)
    if not (values.std(axis=0) > 0.05 * np.abs(values).max(axis=0)).all():
        return False
    return all((np.abs(np.diff(run, axis=0)).max(axis=0) < LARGEST_STEP * extent).all() for run in runs)


def _matter(system: CorpusSystem, values: FloatArray) -> bool:
    """Tell whether every constant has an effect on the derivatives that the others cannot take over."""
    for text in system.equations.values():
        names = tuple(dict.fromkeys(_CONSTANT.findall(text)))
        program = from_infix(text, (*system.states, *names))

        def at(shift: float, name: str, names: tuple[str, ...] = names, program: Program = program) -> FloatArray:
            shifted = {**system.constants, name: system.constants[name] * (1.0 + shift)} if name else system.constants
            columns = [*values.T, *(np.full(len(values), shifted[constant]) for constant in names)]
            return values_of(program, np.array(columns))

        with np.errstate(all="ignore"):
            slopes = at(0.0, "")
            effects = np.array([(at(1e-4, name) - at(-1e-4, name)) / 2e-4 for name in names]).T
        if not (np.isfinite(slopes).all() and np.isfinite(effects).all()):
            return False
        deviation = float(slopes.std())
        for place in range(len(names)):
            others = np.delete(effects, place, axis=1)
            left = effects[:, place]
            if others.shape[1]:
                left = left - others @ np.linalg.lstsq(others, left, rcond=None)[0]
            if not float(np.sqrt((left**2).mean())) > LEAST_EFFECT * deviation:
                return False
    return True
