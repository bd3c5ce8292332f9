"""Which laws the rows of one short table tell from other textbook forms with as many constants.

A law is told by its rows where no other form describes the very values in the file about as well. Every form has its
constants and its initial values fitted by maximum likelihood, the errors of the file being known, and is charged half
the logarithm of the rows for each constant (Schwarz, Annals of Statistics 6 (1978) 461). Forms that have the law as a
special case are none of them: a longer form never describes the rows worse.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from atoll_core.data.dataset import FloatArray
from benchmarks.harness.solving import DivergedError
from benchmarks.judging.errors import values_on
from benchmarks.verdicts.simulation import CONSTANT, Run, Texts, simulate, with_numbers

DECIDED: Final = math.log(20.0)
"""Nats by which a law must lead: odds of 20 to 1."""

RIVALS: Final[Mapping[str, tuple[str, ...]]] = {
    "-k1*x": ("-k11", "-k11*x**2", "-k11*sqrt(x)", "-k11*exp(-x)"),
    "k1*(k2 - x)": ("k11 - k12*x**2", "k11 - k12*sqrt(x)", "k11/x - k12", "k11*x - k12*x**2", "k11 - k12*log(x)"),
    "k1*x*(1.0 - x/k2)": (
        "k11*x - k12*x*log(x)", "k11*x - k12*x**3", "k11*x - k12*x*sqrt(x)", "k11 - k12*x", "k11 - k12*x**2",
        "k11*x**2 - k12*x**3", "k11*sqrt(x) - k12*x", "k11*x*exp(-k12*x)",
    ),
    "k1*x - k2*x*log(x)": (
        "k11*x - k12*x**2", "k11*x - k12*x**3", "k11*x - k12*x*sqrt(x)", "k11 - k12*x", "k11 - k12*x**2",
        "k11*sqrt(x) - k12*x",
    ),
    "-k1*x/(k2 + x)": (
        "-k11*sqrt(x)", "-k11*x + k12*x**2", "-k11 - k12*x", "-k11*x**k12", "-k11*log(1 + k12*x)", "-k11*tanh(k12*x)",
        "-k11 - k12*sqrt(x)",
    ),
    "-k1*x - k2*v": (
        "-k11*x - k12*v*abs(v)", "-k11*x - k12*v**3", "-k11*x - k12*v*x**2", "-k11*x - k12*x**3", "-k11*x**3 - k12*v",
        "-k11*sin(x) - k12*v", "-k11*x - k12*v**2", "-k11*x - k12*x**2",
    ),
    "k1*x - k2*x*y": ("k11*x - k12*y", "k11 - k12*y", "k11 - k12*x*y", "k11*x - k12*y*sqrt(x)", "k11*x - k12*y*x**2"),
    "k3*x*y - k4*y": ("k11*x - k12*y", "k11*x - k12", "k11*x*y - k12", "k11*x*y - k12*y**2", "k11*y*sqrt(x) - k12*y"),
}  # fmt: skip
"""Other forms by the law of one state, `v` for the velocity; their constants have numbers that no law uses."""

_EVALUATIONS: Final = 15
"""Steps of a fit: forms begin where they come nearest to the law's rates, from which it is not far."""

_PRECISION: Final = 1e-7


@dataclass(frozen=True, eq=False)
class Measurements:
    """What a table has of one run: columns (R,) of the states that are measured, and the deviations of their errors."""

    columns: Mapping[str, FloatArray]
    errors: Mapping[str, float]

    def misfit(self, texts: Texts, run: Run) -> FloatArray:
        """Return what right-hand sides with constants leave of all values, in deviations; raises DivergedError."""
        states = simulate(with_numbers(texts, run.constants), run, _PRECISION)
        places = {state: place for place, state in enumerate(texts)}
        return np.concatenate(
            [(states[:, places[state]] - column) / self.errors[state] for state, column in self.columns.items()]
        )


def leads(texts: Texts, run: Run, clean: FloatArray, measured: Measurements) -> dict[str, float]:
    """Return for each state with rivals by how many nats its law describes the rows better than the best of them.

    `clean` are the states (R, S) without errors; the other states keep their laws.
    """
    own = _nats(texts, run, measured)
    found = {}
    for state, law in texts.items():
        rivals = [rival.replace("v", "x_dot") if "x_dot" in law else rival
                  for rival in RIVALS.get(law.replace("x_dot", "v"), ())]  # fmt: skip
        others = [
            _nats({**texts, state: rival}, begun, measured)
            for rival in rivals
            for begun in _begun(texts, state, rival, run, clean)
        ]
        if rivals:
            found[state] = min(others, default=math.inf) - own
    return found


def _nats(texts: Texts, run: Run, measured: Measurements) -> float:
    """Return half the sum of squares at the best constants and initial values, with the price of the constants."""
    names = [*dict.fromkeys(_names(texts.values()))]
    begun = np.array([*(run.constants[name] for name in names), *run.start])
    sizes = np.where(begun != 0.0, np.abs(begun), 1.0)
    rows = sum(map(len, measured.columns.values()))

    def misfit(numbers: FloatArray) -> FloatArray:
        constants = dict(zip(names, numbers.tolist(), strict=False))
        try:
            return measured.misfit(
                texts, replace(run, constants=constants, start=tuple(numbers[len(names) :].tolist()))
            )
        except DivergedError:
            return np.full(rows, 1e6)

    fit = least_squares(misfit, begun, x_scale=sizes, max_nfev=_EVALUATIONS)
    return float(fit.cost) + 0.5 * len(names) * math.log(rows)


def _names(texts: Iterable[str]) -> Iterator[str]:
    for text in texts:
        yield from CONSTANT.findall(text)


def _begun(texts: Texts, state: str, rival: str, run: Run, clean: FloatArray) -> Iterator[Run]:
    """Yield the run with constants by which a rival comes near the law at the measured states, if there are any."""
    names = [*dict.fromkeys(CONSTANT.findall(rival))]
    columns = dict(zip(texts, clean.T, strict=True))
    target = _values(with_numbers(texts, run.constants)[state], columns)

    def left(numbers: FloatArray) -> FloatArray:
        constants = dict(zip(names, numbers.tolist(), strict=True))
        return np.nan_to_num(_values(with_numbers({state: rival}, constants)[state], columns) - target, nan=1e6)

    size = float(np.abs(target).max())
    begun = least_squares(left, np.ones(len(names)), x_scale=max(size, 1e-6), max_nfev=200)
    if math.isfinite(begun.cost):
        yield replace(run, constants={**run.constants, **dict(zip(names, begun.x.tolist(), strict=True))})


def _values(text: str, columns: Mapping[str, FloatArray]) -> FloatArray:
    with np.errstate(all="ignore"):
        return np.asarray(values_on(text, columns), np.float64)
