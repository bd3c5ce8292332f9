"""Recordings of known systems, for the tests of what is fitted to trajectories."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import solve_ivp

from atoll_coordinator.data.recording import Preparation, Recording, StateSmoothing, Trajectory
from atoll_coordinator.model.pools import Pool
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.shooting.measurements import TrajectoryMeasurements, measurements_of
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_core.data.dataset import FloatArray, Problem
from atoll_core.data.table import Table
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import Program
from atoll_core.expression.simplification import complexity, simplify_program
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from atoll_core.expression.writing.shortest import shortest
from atoll_core.search.pareto import FrontEntry

Rates = Callable[[float, Sequence[float]], Sequence[float]]
Wave = Callable[[FloatArray], FloatArray]


_SOLVED: dict[tuple[Rates, tuple[float, ...], bytes], FloatArray] = {}


@dataclass(frozen=True)
class Known:
    """A system whose solutions are known: its states' `rates` at (time, states), and `inputs` with their slopes."""

    states: tuple[str, ...]
    rates: Rates
    inputs: dict[str, tuple[Wave, Wave]] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        return (*self.states, *self.inputs)

    def parsed(self, text: str) -> Program:
        return shortest(from_infix(text, self.names))

    def text(self, program: Program) -> str:
        return to_infix(program, self.names)

    def values(self, start: Sequence[float], times: FloatArray) -> FloatArray:
        """Return the solution (D, R) from `start`; solved once."""
        key = (self.rates, tuple(start), times.tobytes())
        if key not in _SOLVED:
            span = (float(times[0]), float(times[-1]))
            with np.errstate(all="ignore"):
                solution = solve_ivp(self.rates, span, start, "DOP853", times, rtol=1e-12, atol=1e-13)
            assert solution.success
            _SOLVED[key] = solution.y
        return _SOLVED[key].copy()


def lotka(_: float, z: Sequence[float]) -> Sequence[float]:
    x, y = z
    return [3.0 * x - 2.0 * x * y - x * x, 2.0 * y - x * y - y * y]


LOTKA = Known(("x", "y"), lotka)
LOTKA_TEXT = ("3*x - 2*x*y - x**2", "2*y - x*y - y**2")
DECAY = Known(("x",), lambda _, z: [-0.5 * z[0]])
DRIVEN = Known(
    ("x",),
    lambda t, z: [-0.8 * z[0] + 1.5 * np.cos(2.0 * t)],
    {"u": (lambda t: np.cos(2.0 * t), lambda t: -2.0 * np.sin(2.0 * t))},
)
SWING = Known(("x", "y"), lambda _, z: [z[1], -2.0 * z[0] - 0.3 * z[1]])


def recording(
    known: Known,
    starts: Sequence[Sequence[float]],
    times: FloatArray | Sequence[FloatArray],
    noise: float | Sequence[float] = 0.0,
    seed: int = 0,
    held_out: Sequence[int] = (),
) -> Recording:
    """Return trajectories from `starts`, smoothed without error; `noise` is the standard deviation of each state."""
    draw = np.random.default_rng(seed)
    instants = times if isinstance(times, list) else [times] * len(starts)
    deviations = np.broadcast_to(np.asarray(noise, dtype=np.float64), len(known.states))
    trajectories = []
    for index, (start, at) in enumerate(zip(starts, instants, strict=True)):
        values = known.values(start, at)
        slopes = np.array([known.rates(t, z) for t, z in zip(at, values.T, strict=True)]).T
        measured = values + deviations[:, None] * draw.standard_normal(values.shape)
        waves = [wave(at) for wave, _ in known.inputs.values()]
        rises = [rise(at) for _, rise in known.inputs.values()]
        stacked = [np.array(them).reshape(len(known.inputs), len(at)) for them in (waves, rises)]
        slopes = np.ascontiguousarray(slopes)
        trajectories.append(Trajectory(str(index + 1), at, measured, values, slopes, *stacked, index in held_out))
    smoothing = tuple(
        StateSmoothing(name, "loess" if deviation else "interpolation", float(deviation) or 1e-9, float(deviation))
        for name, deviation in zip(known.states, deviations.tolist(), strict=True)
    )
    inputs = tuple(known.inputs)
    return Recording(known.states, known.states, (), inputs, inputs, 1, 0.0, smoothing, tuple(trajectories))


def table(
    known: Known, starts: Sequence[Sequence[float]], times: FloatArray, noise: float = 0.0, seed: int = 0
) -> Table:
    """Return measured trajectories as a user hands them in; `noise` is a share of each state's standard deviation."""
    draw = np.random.default_rng(seed)
    values = np.concatenate([known.values(start, times) for start in starts], axis=1)
    values = values + noise * values.std(axis=1)[:, None] * draw.standard_normal(values.shape)
    count = values.shape[1]
    columns = [np.tile(times, len(starts)), *values]
    columns += [np.tile(wave(times), len(starts)) for wave, _ in known.inputs.values()]
    rows = np.arange(count, dtype=np.int64)
    names = ("t", *known.names)
    starts_at = tuple(range(0, count, len(times)))
    return Table(names, ("",) * len(names), np.array(columns), starts_at, ("a.csv",), 0 * rows, rows + 2, ())


def pools(preparation: Preparation, **texts: Sequence[str]) -> dict[str, Pool]:
    """Return what a search might hand on of each variable: these equations, by complexity."""
    pools_made = {}
    for name, equations in texts.items():
        problem = preparation.dataset.problem(name)
        entries = [entry(from_infix(text, problem.names), problem) for text in equations]
        pools_made[name] = Pool(tuple(sorted(entries, key=lambda entry: entry.complexity)))
    return pools_made


def entry(program: Program, problem: Problem) -> FrontEntry:
    program = simplify_program(program)
    errors = values_of(program, problem.inputs) - problem.target.values
    mae, mse = float(np.mean(np.abs(errors))), float(np.mean(errors**2))
    return FrontEntry(complexity(program), mae, mse, 0, 1, 0, program.to_bytes())


def measurements(
    known: Known, starts: Sequence[Sequence[float]], times: FloatArray, **options
) -> TrajectoryMeasurements:
    return measurements_of(recording(known, starts, times, **options), range(len(known.states)))


def compare(known: Known, deviation: TrajectoryMeasurements, precision: float = 1e-6, **options) -> ModelComparison:
    return ModelComparison(MultipleShooting(deviation, precision), known.names, **options)
