"""Coverage of forecasts and of smoothed states: ``python -m benchmarks.forecasts``.

A table is drawn from a system whose equations are known; its last quarter (chaotic: two fifths) is held out. The form
of the law is given, so the program measures forecasts and not searches: constants, states and bands follow from the
other rows. Counted for each state are the share of held-out times within the horizon at which the 95 % band contains
the true state, and the share of the given rows at which the band of the smoothed state does.
"""

import sys
import time
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from atoll.experiments.forecast import ForecastRequest, forecast
from atoll.experiments.smoothing import smooth
from atoll.terminal.output import note, say, table
from atoll_coordinator.result.result import Result
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import AtollError
from benchmarks.corpus.systems import draw_system, solution
from benchmarks.harness.command_line import option, program, seeds_of, whole
from benchmarks.harness.record import Record
from benchmarks.harness.solving import DivergedError
from benchmarks.harness.systems import Sampled, table_of
from benchmarks.judging.generalisation import field_of

CHAOTIC: Final[dict[str, tuple[dict[str, str], tuple[float, ...], float]]] = {
    "lorenz": ({"x": "10*(y - x)", "y": "x*(28 - z) - y", "z": "x*y - 2.6666667*z"}, (-8.0, 8.0, 27.0), 25.0),
    "roessler": ({"x": "-y - z", "y": "x + 0.2*y", "z": "0.2 + z*(x - 5.7)"}, (1.0, 1.0, 0.0), 150.0),
    "halvorsen": (
        {"x": "-1.4*x - 4*y - 4*z - y*y", "y": "-1.4*y - 4*z - 4*x - z*z", "z": "-1.4*z - 4*x - 4*y - x*x"},
        (-5.0, 0.5, 1.0), 25.0,
    ),
    "sprott b": ({"x": "y*z", "y": "x - y", "z": "1 - x*y"}, (0.5, 0.5, 0.1), 75.0),
    "chen": ({"x": "35*(y - x)", "y": "28*y - 7*x - x*z", "z": "x*y - 3*z"}, (5.0, 5.0, 20.0), 10.0),
}  # fmt: skip
"""Right-hand sides, initial state and duration of chaotic systems."""
ROWS: Final = {False: 133, True: 667}
"""Rows of a whole table: not chaotic, chaotic."""
_GIVEN: Final = {False: 0.75, True: 0.6}
"""Given share of the rows: errors of a chaotic system need time to grow."""


@dataclass(frozen=True)
class Outcome:
    """One state of one table: shares of covered times (None: the horizon ends at once), and the horizon as a share of
    the held-out time. `error` is the root mean squared error of the smoothed state, divided by the noise."""

    system: str
    is_chaotic: bool
    noise: float
    state: str
    covered: float | None
    horizon: float
    smoothed: float
    error: float
    pieces: int
    seconds: float


def systems(count: int, seeds: Sequence[int]) -> Iterator[tuple[str, dict[str, str], tuple[float, ...], float, bool]]:
    """Yield name, right-hand sides, initial state, duration and whether the system is chaotic.

    Systems that blow up from the drawn initial state are left out.
    """
    yielded = 0
    for seed in seeds:
        drawn = draw_system(seed, 1 + seed % 3)
        start = drawn.draw_start(np.random.default_rng([seed, 7]))
        try:
            solution(drawn.field(), start, np.linspace(0.0, drawn.duration, ROWS[False]))
        except DivergedError:
            continue
        yield f"{drawn.name} {seed}", drawn.truths, start, drawn.duration, False
        yielded += 1
        if yielded == count:
            break
    for name, (equations, start, duration) in CHAOTIC.items():
        yield name, equations, start, duration, True


def result_of(equations: Mapping[str, str]) -> Result:
    """Return a result that has only equations: their constants are fitted to the given table."""
    entries = [{"variable": name, "lhs": f"d{name}/dt", "expression": text} for name, text in equations.items()]
    system = {"kind": "dynamics", "order": 1, "time": "t", "states": [*equations], "inputs": []}
    content: dict[str, Any] = {"schema": 1, "equations": entries, "symbols": {name: name for name in equations}}
    return Result.of(content | {"system": system})


def measure(
    name: str, equations: Mapping[str, str], start: Sequence[float], duration: float, noise: float, *,
    is_chaotic: bool,
) -> list[Outcome]:  # fmt: skip
    """Return the outcome of each state of a table with `noise`, a share of the standard deviation of each state."""
    times = np.linspace(0.0, duration, ROWS[is_chaotic])
    field = field_of([*equations.values()], [*equations])
    truth = solution(field, start, times)
    given = round(_GIVEN[is_chaotic] * len(times))
    random = np.random.default_rng([*name.encode(), round(1e4 * noise)])
    sizes = noise * truth[:given].std(axis=0)
    noisy = truth[:given] + sizes * random.standard_normal((given, len(equations)))
    data = table_of(Sampled(tuple(equations), (times[:given],), (noisy,)))
    began, result = time.process_time(), result_of(equations)
    smoothed = smooth(result, data).trajectories[0]
    step = float(times[1] - times[0])
    found = forecast(result, ForecastRequest(float(times[-1] - times[given - 1]), step=step), data)
    seconds = time.process_time() - began
    after = truth[given - 1 : given - 1 + len(found.t)]
    outcomes = []
    for place, state in enumerate(found.states):
        covered = _covered(after[:, place], *found.band(state))
        end = found.horizons[state]
        within = found.t - found.t[0] <= (np.inf if end is None else end)
        known = (smoothed.lower[:, place], smoothed.upper[:, place])
        error = float(np.sqrt(np.mean((smoothed.x[:, place] - truth[:given, place]) ** 2)) / sizes[place])
        outcomes.append(Outcome(
            name, is_chaotic, noise, state, float(covered[within].mean()) if within.sum() > 1 else None,
            1.0 if end is None else end / float(found.t[-1] - found.t[0]),
            float(_covered(truth[:given, place], *known).mean()), error, len(smoothed.joins) + 1, seconds,
        ))  # fmt: skip
    return outcomes


def _covered(values: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    return np.asarray((values >= lower) & (values <= upper), dtype=np.float64)


def summary(outcomes: Sequence[Outcome]) -> str:
    """Return a table: systems of a kind at a noise level in a row."""
    rows = []
    for is_chaotic, noise in sorted({(outcome.is_chaotic, outcome.noise) for outcome in outcomes}):
        own = [outcome for outcome in outcomes if (outcome.is_chaotic, outcome.noise) == (is_chaotic, noise)]
        covered = [outcome.covered for outcome in own if outcome.covered is not None]
        rows.append((
            "chaotic" if is_chaotic else "not chaotic", f"{100 * noise:g} %",
            f"{len({outcome.system for outcome in own})}, {len(own)}",
            f"{100 * np.mean(covered):.0f} %", f"{sum(share < 0.5 for share in covered)} of {len(covered)}",
            f"{100 * np.mean([outcome.horizon for outcome in own]):.0f} %",
            f"{100 * np.mean([outcome.smoothed for outcome in own]):.0f} %",
            f"{np.median([outcome.error for outcome in own]):.2f}",
            f"{np.median([outcome.seconds for outcome in own]):.1f}",
        ))  # fmt: skip
    heads = (
        "kind", "noise", "systems, states", "forecast covered", "states below half", "horizon", "smoothed covered",
        "error over noise", "processor s",
    )  # fmt: skip
    return table(heads, rows)


@program(
    "benchmarks.forecasts",
    __doc__,
    option("--count", type=whole, default=20, help="systems that are not chaotic; default: 20"),
    seeds_of("0-99", "seeds of these systems; default: 0-99"),
    option("--levels", type=float, nargs="+", default=(0.01, 0.05), help="default: 0.01 0.05"),
    option("--json", type=Path, metavar="FILE", help="file to write the figures to"),
)
def main(options: Namespace) -> int:
    outcomes: list[Outcome] = []
    record = Record("forecasts", sys.argv[1:], options.json)
    for name, equations, start, duration, is_chaotic in systems(options.count, options.seeds):
        for noise in options.levels:
            try:
                found = measure(name, equations, start, duration, noise, is_chaotic=is_chaotic)
            except AtollError as error:
                note(f"{name}, {100 * noise:g} %: {error}")
                continue
            for outcome in found:
                record.add(outcome)
                covered = "-" if outcome.covered is None else f"{100 * outcome.covered:.0f} %"
                say(
                    f"{name:24} {100 * noise:g} % {outcome.state:3} covered {covered:5} horizon "
                    f"{100 * outcome.horizon:3.0f} %  smoothed {100 * outcome.smoothed:3.0f} % error "
                    f"{outcome.error:.2f} pieces {outcome.pieces}"
                )
            outcomes += found
    say(summary(outcomes))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
