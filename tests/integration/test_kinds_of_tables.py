"""Kinds of tables on which verdicts were wrong or advice was missing: whole jobs, a table of its own for each kind.

What a table says is not always enough for its law. What is never allowed is an equation of another form that is called
"good" or "exact"; and where a column or what an equation leaves tells what kind it is, that is said.
"""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from atoll_core.data.dataset import FloatArray
from benchmarks.first_hour.cases import PREY, Case
from benchmarks.first_hour.tables import Columns, closed, grid, joined, noisy, solved
from tests.integration.whole_jobs import answered, outcome_of

LOGISTIC = {"N": "0.9*N - 0.018*N*N"}
SWING = {"x": "v", "v": "-4*x - 0.3*v"}


def growing(rows: int = 120) -> Columns:
    """Return logistic growth from 4 to 50."""
    return closed(grid(rows, 0.09), N=lambda t: 50.0 / (1.0 + 11.5 * np.exp(-0.9 * t)))


def with_errors_of(columns: Columns, of: Callable[[FloatArray], FloatArray], seed: int) -> Columns:
    """Return the same with normal errors whose deviations follow from the values."""
    draw = np.random.default_rng(seed)
    return {name: values if name == "t" else values + of(values) * draw.standard_normal(len(values))
            for name, values in columns.items()}  # fmt: skip


def swinging(rows: int = 200) -> Columns:
    """Return a damped swing."""
    return solved(lambda _, z: (z[1], -4.0 * z[0] - 0.3 * z[1]), "xv", (2.0, 0.0), grid(rows, 0.06))


def hunted(rows: int = 150) -> Columns:
    """Return predators and prey."""
    return solved(lambda _, z: (1.1 * z[0] - 0.4 * z[0] * z[1], 0.1 * z[0] * z[1] - 0.4 * z[1]), "xy", (10.0, 5.0),
                  grid(rows, 0.13))  # fmt: skip


def with_outliers() -> Columns:
    """Return a swing with 1 % of noise, five of whose values are far off."""
    columns = noisy(swinging(), 0.01, 5)
    columns["x"][[17, 60, 101, 140, 183]] += np.array([2.0, -1.5, 1.8, -2.2, 1.6])
    return columns


def in_bursts() -> Columns:
    """Return a circle measured in three bursts of irregular rows, with pauses between them."""
    draw = np.random.default_rng(8)
    times = np.sort(np.concatenate([start + 1.2 * draw.random(30) for start in (0.0, 3.0, 6.5)]))
    return noisy({"t": times, "x": np.cos(times), "y": -np.sin(times)}, 0.005, 9)


def charged_then_emptied() -> Columns:
    """Return what is filled for ten units of time and then emptied by another law."""
    times = grid(200, 0.1)
    full = 2.0 * (1.0 - math.exp(-10.0))
    return noisy({"t": times, "c": np.where(times < 10.0, 2.0 * (1.0 - np.exp(-times)),
                                            np.maximum(full - 0.35 * (times - 10.0), 0.0))}, 0.01, 10)  # fmt: skip


def rubbing() -> Columns:
    """Return a swing that dry friction brings to rest."""
    times = grid(200, 0.04)
    return noisy(
        solved(lambda _, z: (z[1], -4.0 * z[0] - 0.5 * math.tanh(200.0 * z[1])), "xv", (3.0, 0.0), times), 0.005, 11
    )


def drifting() -> Columns:
    """Return growth whose rate falls with time, which no column tells."""
    return noisy(
        solved(lambda t, z: ((0.5 - 0.02 * t) * z[0] * (1.0 - z[0] / 8.0),), "N", (0.3,), grid(150, 0.2)), 0.01, 12
    )


def shaken() -> Columns:
    """Return a swing that is driven with a period of 3.5 by what no column has."""
    return noisy(
        solved(lambda t, z: (z[1], -2.0 * z[0] - 0.2 * z[1] + math.cos(1.8 * t)), "xv", (1.0, 0.0), grid(250, 0.1)),
        0.01,
        13,
    )


def in_three_levels() -> Columns:
    """Return a circle whose sensor tells -1, 0 and 1."""
    times = grid(200, 0.1)
    return {"t": times, "x": np.round(np.cos(times)), "v": np.round(-np.sin(times))}


def clipped() -> Columns:
    """Return predators and prey; the sensor of the prey ends at 7."""
    columns = noisy(hunted(), 0.002, 14)
    return {**columns, "x": np.minimum(columns["x"], 7.0)}


@dataclass(frozen=True)
class Kind:
    """A table, a pattern among the warnings, reasons and advice about it, and the verdicts that it may have."""

    case: Case
    said: str = ""
    grades: tuple[str, ...] = ("exact", "good", "doubtful", "no model")


def kind(
    name: str, make: Callable[[], Columns], laws: Mapping[str, str | None], said: str = "", *,
    clean: Callable[[], Columns] | None = None, grades: tuple[str, ...] = Kind.grades,
) -> Kind:  # fmt: skip
    return Kind(Case(name, make, laws, clean=clean, tolerance=0.2), said, grades)


UNKNOWN = ("doubtful", "no model")
KINDS = [
    kind("errors in proportion", lambda: with_errors_of(growing(), lambda n: 0.05 * n, 1), LOGISTIC, clean=growing),
    kind("errors that grow", lambda: with_errors_of(growing(), lambda n: 0.2 + 0.03 * n, 2), LOGISTIC, clean=growing),
    kind("counts", lambda: {"t": growing()["t"], "N": np.random.default_rng(3).poisson(growing()["N"]).astype(float)},
         LOGISTIC, clean=growing),
    kind("prey and predators in proportion", lambda: with_errors_of(hunted(), lambda n: 0.03 * n, 4), PREY,
         clean=hunted),
    kind("outliers", with_outliers, SWING, "robust", clean=swinging),
    kind("bursts", in_bursts, {"x": "y", "y": "-x"}),
    kind("two regimes", charged_then_emptied, {"c": None}, grades=UNKNOWN),
    kind("dry friction", rubbing, {"x": "v", "v": "-4*x - 0.5*v/abs(v)"}),
    kind("a drift in time", drifting, {"N": None}, grades=UNKNOWN),
    kind("a drive that was not measured", shaken, {"x": "v", "v": None}, "period|have different rates"),
    kind("three levels", in_three_levels, {"x": "v", "v": "-x"}, "takes 3 values only"),
    kind("a clipped sensor", clipped, PREY, "of a sensor at the end of its range", clean=hunted),
    kind("a total beside its parts", lambda: joined(noisy(hunted(), 0.01, 15), s=noisy(hunted(), 0.01, 15)["x"]
         + 2.0 * noisy(hunted(), 0.01, 15)["y"]), PREY, r"'s' is x \+ 2\*y in every row", clean=hunted),
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("given", KINDS, ids=lambda given: given.case.name)
def test_nothing_else_is_relied_on_and_what_can_be_told_is_said(given: Kind, tmp_path: Path) -> None:
    with np.errstate(all="ignore"):  # as in the processes that do this
        answer, view = answered(given.case, tmp_path)
    outcome = outcome_of(given.case, answer, view)
    assert outcome.end == "done", outcome.sentence
    for equation in outcome.equations:
        assert equation.is_found or not equation.is_confident, equation
        assert (equation.verdict or "no model") in given.grades, equation
    reasons = [equation.get("reason") or "" for equation in answer["equations"]]
    told = "\n".join([*answer["warnings"], *reasons, str(answer.get("hints", ""))])
    assert re.search(given.said, told), told
