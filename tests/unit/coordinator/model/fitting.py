"""Problems and programs for the tests of what is done after the search."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from atoll_coordinator.settings import SETTINGS, Settings
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset, FloatArray, Problem, Target
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import Program
from atoll_core.expression.simplification import complexity, simplify_program
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from atoll_core.search.pareto import FrontEntry

NAMES = ("x", "y")


def settings(stage: str, **numbers: Any) -> Settings:
    """Return the settings with other numbers of one stage."""
    return replace(SETTINGS, **{stage: replace(getattr(SETTINGS, stage), **numbers)})


def parsed(text: str) -> Program:
    return simplify_program(from_infix(text, NAMES))


def shown(program: Program) -> str:
    return to_infix(program, NAMES)


def dataset(truth: Callable[[FloatArray, FloatArray], FloatArray], noise: float = 0.0, rows: int = 200) -> Dataset:
    """Rows over [0.5, 3] x [-2, 2]; noise is relative to the root mean square of the labels."""
    draw = np.random.default_rng(7)
    inputs = np.stack([draw.uniform(0.5, 3.0, rows), draw.uniform(-2.0, 2.0, rows)])
    labels = truth(*inputs)
    labels = labels + draw.normal(0.0, 1.0, rows) * noise * np.sqrt(np.mean(labels * labels))
    target = Target("label", "label", labels, 0.0, float(np.std(labels)))
    return Dataset(NAMES, inputs, (target,), {name: name for name in NAMES})


def problem(truth: Callable[[FloatArray, FloatArray], FloatArray], noise: float = 0.0, rows: int = 200) -> Problem:
    return dataset(truth, noise, rows).problem("label")


def entry(text: str, of: Problem) -> FrontEntry:
    """Return `text` as a member of a front, measured on all rows."""
    program = parsed(text)
    errors = values_of(program, of.inputs) - of.target.values
    return FrontEntry(
        complexity(program), float(np.mean(np.abs(errors))), float(np.mean(errors**2)), 0, 1, 0, program.to_bytes()
    )


CONFIG = JobConfig()
