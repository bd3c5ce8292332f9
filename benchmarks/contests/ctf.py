"""The Common Task Framework's Lorenz contest: predictions for all nine pairs, and the same contest on held-out rows.

Each train set is searched with default options; the law is not assumed. A reconstruction is the states under the law
that was found. A forecast is a simulation of the law from the state at the last row, which is fitted to the last rows.
For the pairs with a scaled parameter, the 100 rows with the unknown value are searched alone: they suffice, and sets
with other values are not used.

The test sets of the contest are not public. So the contest is repeated with rows that are held out of the train sets
(`held_out`), with independent errors of the same size where the contest has noise.

The run can be interrupted. Each law is written into the folder FILE.laws when it is found, each
prediction into FILE.npz and each score into FILE.json. The same command later goes on with these files. A pair whose
search fails has no prediction, which a sentence says; the other pairs are still written.
"""

import json
import time
import warnings
from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

import atoll
from atoll.model.simulation import SimulationWarning
from atoll.terminal.output import note, say
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import AtollError
from benchmarks.contests.protocol import FORECAST, PAIRS, SCORES, STATES, STEP, Pair, long_score, noise_of
from benchmarks.contests.smoothing import WINDOW, states_along
from benchmarks.harness.record import Record
from benchmarks.harness.tables import markdown

FILE: Final = "ctf_lorenz_train.npz"
PUBLISHED: Final[Mapping[str, float]] = {"LSTM": 64.5, "DeepONet": 57.8, "reservoir": 54.9, "SINDy": 19.2}
"""Published means of the twelve scores (arXiv 2510.23166)."""

_FEW: Final = 100
"""Rows of the short sets."""

_SIMULATIONS: Final = 24
"""Number of simulations of a long forecast. On 60 windows of the attractor the most typical of 24 scores 69.7, of 100
69.4, and a single one 64.3."""

_SHIFT: Final = 1e-6
"""Standard deviation of the shifts of initial states, relative to the standard deviation of the states. Errors of the
Lorenz system grow by a factor of 2.5 in 20 rows and 6e9 in 500: short scores keep their first five digits."""


@dataclass(frozen=True, eq=False)
class Task:
    """One prediction: its pair, the rows (N, 3) of its train sets, and the truth (N, 3) if it is known.

    `source` names the last train set; tasks with the same source have the same law.
    """

    pair: Pair
    train: tuple[FloatArray, ...]
    source: str
    truth: FloatArray | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """The shape of the prediction."""
        return (FORECAST if self.pair.is_forecast else len(self.train[-1])), len(STATES)


def load_sets(folder: Path) -> dict[str, FloatArray]:
    """Return the train sets X1 to X10; raises AtollError if the file cannot be read."""
    try:
        with np.load(folder / FILE) as file:
            return {name: np.asarray(file[name], dtype=np.float64) for name in file.files}
    except OSError as error:
        raise AtollError(f"{folder / FILE} cannot be read ({error}); name its folder with --data") from error


def contest(sets: Mapping[str, FloatArray]) -> list[Task]:
    """Return the nine tasks of the contest, without truths."""
    return [Task(pair, tuple(sets[name] for name in pair.train), pair.train[-1]) for pair in PAIRS]


def held_out(sets: Mapping[str, FloatArray], draw: int) -> list[Task]:
    """Return the nine tasks with rows of the train sets in place of the test sets.

    X1 gives the truth of pairs 1 to 7: its last rows, earlier ones with each draw, are held out, and noise of the size
    of X2, X3 and X5 is added. Pair 8 continues 100 rows of the middle one of X6, X7 and X8, and pair 9 of the last one;
    the others are its train sets. So pair 9 lies outside of the range of the known values.
    """
    random = np.random.default_rng(draw)
    end = len(sets["X1"]) - (draw + 1) * FORECAST
    few = end // 2
    clean, later = _parted(sets["X1"], 0, end)
    short, after = _parted(sets["X1"], few, few + _FEW)

    def source(pair: Pair) -> str:
        return f"{pair.train[-1]}-draw{draw}"

    def noisy(rows: FloatArray, like: str) -> FloatArray:
        size = np.sqrt(max(noise_of(sets[like]) ** 2 - noise_of(sets["X1"]) ** 2, 0.0))
        return np.asarray(rows + random.normal(0.0, size, rows.shape))

    weak, strong = noisy(clean, "X2"), noisy(clean, "X3")
    trains = {1: clean, 2: weak, 3: weak, 4: strong, 5: strong, 6: short, 7: noisy(short, "X5")}
    truths = {1: later, 2: clean, 3: later, 4: clean, 5: later, 6: after, 7: after}
    pairs = {number: PAIRS[number - 1] for number in range(1, len(PAIRS) + 1)}
    tasks = [Task(pairs[number], (train,), source(pairs[number]), truths[number]) for number, train in trains.items()]
    for number, others, left_out in ((8, ("X6", "X8"), "X7"), (9, ("X6", "X7"), "X8")):
        given, following = _parted(sets[left_out], end - _FEW, end)
        trains_of_pair = (*(sets[name] for name in others), given)
        tasks.append(Task(pairs[number], trains_of_pair, source(pairs[number]), following))
    return tasks


def _parted(rows: FloatArray, first: int, end: int) -> tuple[FloatArray, FloatArray]:
    """Return the rows from `first` to `end`, and the rows of a forecast after them."""
    return rows[first:end], rows[end : end + FORECAST]


@dataclass(frozen=True)
class Found:
    """A law: its equations by state, their verdicts, and the seconds of its job."""

    equations: tuple[str, ...]
    verdicts: tuple[str, ...]
    seconds: float


class Laws:
    """Searches for laws, kept in a folder (None: only in memory); tasks of the same source share one search."""

    def __init__(self, options: Namespace) -> None:
        self._options = options
        self._folder: Path | None = None if options.out is None else options.out.with_suffix(".laws")
        self._known: dict[str, tuple[atoll.Model, Found] | AtollError] = {}

    def of(self, task: Task) -> tuple[atoll.Model, Found]:
        """Return the law of the last train set of a task; raises AtollError, each time, if its search failed."""
        if task.source not in self._known:
            try:
                self._known[task.source] = self._read_or_search(task)
            except AtollError as error:
                self._known[task.source] = error
        known = self._known[task.source]
        if isinstance(known, AtollError):
            raise known
        return known

    def _read_or_search(self, task: Task) -> tuple[atoll.Model, Found]:
        path = None if self._folder is None else self._folder / f"{task.source}-seed{self._options.seed}.json"
        began = time.monotonic()
        if path is not None and path.exists():
            model = atoll.Model.load(path)
        else:
            rows = task.train[-1]
            note(f"{task.source}: a law of {len(rows)} rows is searched")
            model = atoll.discover(
                _columns(rows), workers=self._options.workers, seed=self._options.seed, progress=False
            )
            if path is not None:
                path.parent.mkdir(parents=True, exist_ok=True)
                model.save(path)
        found = Found(
            tuple(f"{equation.lhs} = {equation.expression}" for equation in model.equations),
            tuple(str(equation.verdict) for equation in model.equations),
            model.result.seconds or 0.0,
        )
        note(f"{task.source}: {'; '.join(found.equations)} ({time.monotonic() - began:.0f} s)")
        return model, found


def _columns(rows: FloatArray) -> dict[str, FloatArray]:
    return {"t": STEP * np.arange(len(rows)), **dict(zip(STATES, rows.T, strict=True))}


def predict(model: atoll.Model, task: Task) -> FloatArray:
    """Return the prediction (N, 3) of a task under a law.

    A long score compares histograms of rows that chaos makes unpredictable. Simulations whose initial states differ by
    less than the data determine are equally probable there, so the most typical of `_SIMULATIONS` is predicted: the one
    whose mean score is best if one of the others is the truth.
    """
    rows = task.train[-1]
    if not task.pair.is_forecast:
        return states_along(model, rows)
    start = states_along(model, rows[-WINDOW:])[-1]
    if "long" not in task.pair.scores:
        return _simulated(model, start)
    shifts = _SHIFT * rows.std(axis=0) * np.random.default_rng(0).normal(size=(_SIMULATIONS, len(STATES)))
    return most_typical([_simulated(model, start + shift) for shift in shifts])


def most_typical(forecasts: Sequence[FloatArray]) -> FloatArray:
    """Return the forecast (N, 3) whose mean long score is best with each of the `forecasts` as the truth."""
    means = [np.mean([long_score(truth, forecast) for truth in forecasts]) for forecast in forecasts]
    return forecasts[int(np.argmax(means))]


def _simulated(model: atoll.Model, start: FloatArray) -> FloatArray:
    """Return the rows (N, 3) of a forecast; if the simulation ends early, its last state is repeated."""
    times = STEP * np.arange(FORECAST + 1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SimulationWarning)
        simulation = model.simulate(dict(zip(STATES, start.tolist(), strict=True)), times, has_bands=False)
    states = np.stack([start, *np.stack([simulation[name] for name in STATES], axis=1)[1:]])
    return np.concatenate([states[1:], np.repeat(states[-1:], FORECAST + 1 - len(states), axis=0)])


def run(options: Namespace) -> int:
    """Write the nine predictions, then score the predictions of held-out rows; return 1 if a prediction is missing."""
    sets, laws = load_sets(options.data), Laws(options)
    record = Record("contests", options.words, options.out)
    scored, pairs = _earlier_scores(options.out), set(options.pairs)
    failures = 0
    if not options.only_held_out:
        tasks = [task for task in contest(sets) if task.pair.number in pairs]
        failures = write_predictions(tasks, laws, options.out)
    for draw in options.draws:
        for task in [task for task in held_out(sets, draw) if task.pair.number in pairs]:
            if not any((entry["pair"], entry["draw"]) == (task.pair.number, draw) for entry in scored):
                scored += _scored(task, draw, laws)
                record.write(scores=scored)
    record.write(scores=scored)
    shown = [entry for draw in options.draws for entry in scored if entry["draw"] == draw and entry["pair"] in pairs]
    if shown:
        say(_table(shown, options.draws))
    say("published means: " + ", ".join(f"{name} {mean}" for name, mean in PUBLISHED.items()))
    return int(failures > 0)


def _earlier_scores(out: Path | None) -> list[dict[str, Any]]:
    """Return the scores that an interrupted run has written; raises AtollError if the file holds something else."""
    if out is None or not out.exists():
        return []
    try:
        return list(json.loads(out.read_text("utf-8")).get("scores", []))
    except (OSError, ValueError, AttributeError) as error:
        raise AtollError(f"{out} is no record of this contest ({error}); name another file with --out") from error


def write_predictions(tasks: Sequence[Task], laws: Laws, out: Path | None) -> int:
    """Write the predictions of tasks into `out` as NPZ, each when it is known; return how many are missing.

    Predictions that the file has already are kept. A pair whose search or simulation fails is left out, and a sentence
    says so.
    """
    path = None if out is None else out.with_suffix(".npz")
    predictions = _earlier_predictions(path)
    failures = 0
    for task in [task for task in tasks if f"pair{task.pair.number}" not in predictions]:
        try:
            predicted = predict(laws.of(task)[0], task)
            if predicted.shape != task.shape or not np.isfinite(predicted).all():
                raise AtollError(f"the prediction has the shape {predicted.shape}, or values that are not finite")
        except AtollError as error:
            say(f"pair {task.pair.number} has no prediction: {error}")
            failures += 1
            continue
        predictions[f"pair{task.pair.number}"] = predicted
        if path is not None:
            _replace(path, predictions)
    shapes = ", ".join(f"{name} {value.shape}" for name, value in sorted(predictions.items()))
    say(f"predictions {f'in {path}' if path else 'without a file'}: {shapes}")
    return failures


def _earlier_predictions(path: Path | None) -> dict[str, FloatArray]:
    if path is None or not path.exists():
        return {}
    with np.load(path) as file:
        return {name: np.asarray(file[name], dtype=np.float64) for name in file.files}


def _replace(path: Path, predictions: Mapping[str, FloatArray]) -> None:
    """Write the predictions whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_suffix(".new.npz")
    np.savez_compressed(new, allow_pickle=False, **predictions)
    new.replace(path)


def _scored(task: Task, draw: int, laws: Laws) -> list[dict[str, Any]]:
    """Return the scores of one task; a job or a fit that fails scores 0, as the protocol scores a prediction of 0."""
    assert task.truth is not None
    about: dict[str, Any] = {"pair": task.pair.number, "draw": draw}
    try:
        model, found = laws.of(task)
        predicted, about = predict(model, task), about | asdict(found)
    except AtollError as error:
        predicted, about = np.zeros_like(task.truth), about | {"failure": str(error)}
    return [about | {"score": name, "value": SCORES[name](task.truth, predicted)} for name in task.pair.scores]


def _table(scored: Sequence[Mapping[str, Any]], draws: Sequence[int]) -> str:
    """Return the scores by pair and draw, with the means over all scores."""
    rows = []
    pairs = [pair for pair in PAIRS if any(entry["pair"] == pair.number for entry in scored)]
    for pair in pairs:
        for name in pair.scores:
            values = [entry["value"] for entry in scored if (entry["pair"], entry["score"]) == (pair.number, name)]
            rows.append([*values, np.mean(values)])
    heads = ("pair", "score", *(f"draw {draw}" for draw in draws), "mean")
    titles = [(str(pair.number), name) for pair in pairs for name in pair.scores]
    lines = [*zip(titles, rows, strict=True), (("all", "mean"), np.mean(rows, axis=0))]
    return markdown(heads, [(*title, *(f"{value:.1f}" for value in values)) for title, values in lines])
