"""The four problems of LLM-SR (ICLR 2025): an explicit target, with rows held out at random and by a variable.

A random quarter measures the error inside of the measured range. The quarter of the rows with the largest values of a
variable measures the error outside: amplitude or time of an oscillator, substrate or temperature of growing bacteria,
temperature of a metal. The published test of the metal is a temperature between the given ones, so one of these is held
out, too. Published figures are of other rows of the same problems.
"""

import time
import warnings
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

import atoll
from atoll.model.simulation import ExtrapolationWarning
from atoll.terminal.output import note, say
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import AtollError
from benchmarks.harness.record import Record
from benchmarks.harness.tables import markdown
from benchmarks.judging.generalisation import GOOD_R2

_QUARTER: Final = 0.25

Columns = dict[str, FloatArray]


Rows = npt.NDArray[np.bool_]
Split = Callable[[Columns], Rows]
"""Returns which rows are held out."""


def at_random(columns: Columns) -> Rows:
    """Hold out a random quarter of the rows."""
    rows = len(next(iter(columns.values())))
    is_held_out = np.zeros(rows, dtype=np.bool_)
    is_held_out[np.random.default_rng(0).permutation(rows)[: int(_QUARTER * rows)]] = True
    return is_held_out


def beyond(values: Callable[[Columns], FloatArray]) -> Split:
    """Hold out the rows with the largest values: a quarter, or fewer if many rows have the value of the threshold."""

    def split(columns: Columns) -> Rows:
        known = values(columns)
        return np.asarray(known > np.quantile(known, 1.0 - _QUARTER, method="higher"))

    return split


@dataclass(frozen=True)
class Problem:
    """A target as a function of columns, the splits by name, and the smallest published errors, in and out of
    distribution."""

    target: str
    outside: Mapping[str, Split]
    published: tuple[float, float]

    @property
    def splits(self) -> dict[str, Split]:
        """All splits: at random, and the ones outside."""
        return {RANDOM: at_random, **self.outside}


RANDOM: Final = "random"

PROBLEMS: Final[Mapping[str, Problem]] = {
    "oscillator1": Problem("a", {"largest |x|": beyond(lambda columns: np.abs(columns["x"]))}, (4.65e-7, 5e-4)),
    "oscillator2": Problem("a", {"earliest t": beyond(lambda columns: -columns["t"])}, (2e-7, 4e-5)),
    "bactgrow": Problem(
        "db",
        {"largest s": beyond(lambda columns: columns["s"]), "largest temp": beyond(lambda columns: columns["temp"])},
        (0.0026, 0.0037),
    ),
    "stressstrain": Problem(
        "stress",
        {"temp = 0.5": lambda columns: columns["temp"] == 0.5, "largest temp": beyond(lambda columns: columns["temp"])},
        (0.016, 0.095),
    ),
}
"""The published errors are those of LLM-SR. A later method has about 1e-25 for oscillator1."""


@dataclass(frozen=True)
class Outcome:
    """One search: the equation, its verdict, and the normalised mean squared errors of its rows and held-out rows.

    `held`: R2 of the held-out rows is above 0.9. `undefined`: held-out rows where the equation has no value.
    """

    problem: str
    split: str
    rows: int
    seconds: float
    equation: str = ""
    verdict: str = ""
    reason: str = ""
    error: float = np.nan
    held_out_error: float = np.nan
    undefined: int = 0
    failure: str = ""

    @property
    def held(self) -> bool:
        """Whether the held-out rows were predicted."""
        return 1.0 - self.held_out_error > GOOD_R2


def load(folder: Path, name: str) -> Columns:
    """Return the columns of the train set of a problem; raises AtollError if the file cannot be read."""
    path = folder / f"llmsr_{name}_train.csv"
    try:
        head, *_ = path.read_text("utf-8").split("\n", 1)
        return dict(zip(head.strip().split(","), np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))
    except (OSError, ValueError) as error:
        raise AtollError(f"{path} cannot be read ({error}); name its folder with --data") from error


def normalised_error(target: FloatArray, predicted: FloatArray) -> float:
    """Return the mean squared error over the variance of the target; undefined predictions count as its mean."""
    values = np.where(np.isfinite(predicted), predicted, target.mean())
    return float(np.mean((target - values) ** 2) / target.var())


def search(name: str, split: str, options: Namespace) -> Outcome:
    """Search one problem without the held-out rows of a split.

    The first job file has the settings of the search for the target. Each further one searches a factor: its target is
    the measured target over the product of the laws so far, and its weights are the squares of this product, so that
    the squared errors of the target are compared. The equation is the product.
    """
    problem, columns = PROBLEMS[name], load(options.data, name)
    is_held_out = problem.splits[split](columns)
    own, other = ({key: values[rows] for key, values in columns.items()} for rows in (~is_held_out, is_held_out))
    models, began = list[atoll.Model](), time.monotonic()
    try:
        for factor, config in enumerate(options.config or [None]):
            models.append(_search_factor(problem.target, own, models, config, options.seed + factor, options))
            note(f"{name}, {split}: {models[-1].equations[0].expression}")
    except AtollError as error:
        return Outcome(name, split, len(own[problem.target]), time.monotonic() - began, failure=str(error))
    seconds, equations = time.monotonic() - began, [model.equations[0] for model in models]
    predicted = [_product(models, part) for part in (own, other)]
    errors = [
        normalised_error(part[problem.target], values) for part, values in zip((own, other), predicted, strict=True)
    ]
    undefined = int(np.sum(~np.isfinite(predicted[1])))
    return Outcome(
        name, split, len(predicted[0]), seconds, " * ".join(f"({equation.expression})" for equation in equations),
        ", ".join(str(equation.verdict) for equation in equations),
        "; ".join(equation.reason or "" for equation in equations), errors[0], errors[1], undefined,
    )  # fmt: skip


def _search_factor(
    target: str, own: Columns, models: Sequence[atoll.Model], config: str | None, seed: int, options: Namespace
) -> atoll.Model:
    """Search the target, or the factor that the product of `models` lacks."""
    variables = [key for key in own if key != target]
    settings = {"max_time": options.max_time, "config": config, "weights": _WEIGHTS if models else None}
    table = dict(own)
    if models:
        known = _product(models, own)
        table |= {target: own[target] / known, _WEIGHTS: known**2 / np.mean(known**2)}
    return atoll.discover(
        table, target=target, inputs=variables, workers=options.workers, seed=seed, progress=False,
        **{option: value for option, value in settings.items() if value is not None},
    )  # fmt: skip


_WEIGHTS: Final = "weight"


def _product(models: Sequence[atoll.Model], columns: Columns) -> FloatArray:
    """Return the product of the predictions of models, also for rows outside of the measured range."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExtrapolationWarning)
        return np.asarray(np.prod([np.asarray(model.predict(columns)) for model in models], axis=0))


def run(options: Namespace) -> None:
    """Search all problems with both splits and print the errors next to the published ones."""
    record, outcomes = Record("contests", options.words, options.out), list[Outcome]()
    for name in options.problems:
        for split in [split for split in PROBLEMS[name].splits if split in options.splits]:
            outcomes.append(search(name, split, options))
            if outcomes[-1].failure:
                note(f"{name}, {split}: {outcomes[-1].failure}")
            record.write(runs=[asdict(outcome) | {"held": outcome.held} for outcome in outcomes])
    say(table(outcomes))


def table(outcomes: Sequence[Outcome]) -> str:
    """Return the outcomes as a table."""
    rows = []
    for outcome in outcomes:
        published = PROBLEMS[outcome.problem].published[outcome.split != RANDOM]
        cells: tuple[Any, ...] = (
            outcome.problem, outcome.split, f"{outcome.error:.2g}", f"{outcome.held_out_error:.2g}", f"{published:.2g}",
            outcome.verdict or outcome.failure, "yes" if outcome.held else "no", f"{outcome.seconds:.0f}",
        )  # fmt: skip
        rows.append(cells)
    heads = ("problem", "held out", "error of own rows", "of held-out rows", "published", "verdict", "predicted", "s")
    return markdown(heads, rows)
