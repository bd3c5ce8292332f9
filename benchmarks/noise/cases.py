"""Single cases beside the seven systems: input that no model fits, long recordings, a measured input, real data."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from atoll.terminal.output import clipped, note, say, shortened, table
from atoll_coordinator.data.reading.files import read_table
from atoll_core.config import DataConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from benchmarks.harness.campaign import attempt
from benchmarks.harness.jobs import configured
from benchmarks.harness.service import Searches, searching
from benchmarks.harness.stopwatch import Stopwatch, largest_child_mb
from benchmarks.harness.systems import Sampled, table_of, trajectories, with_noise
from benchmarks.harness.tables import percent
from benchmarks.noise.data import Case, Key
from benchmarks.noise.data import Path as Course
from benchmarks.noise.judging import search
from benchmarks.noise.tables import miss

Rows = list[dict[str, Any]]
Section = Callable[[int, float | None, Sequence[int]], Rows]
"""From workers, seconds for a search and seeds to what was measured; prints it, too."""

HARD_LIMIT_S: Final = 300.0
"""No input of the section ``hard`` may take longer until there is a verdict."""

RECORDINGS: Final = (
    ("4 x 10 s, step 0.1", 0.1, 10.0),
    ("4 x 10 s, step 0.0004", 0.0004, 10.0),
    ("4 x 500 s, step 0.02", 0.02, 500.0),
)
"""Of the predator and its prey, which oscillate for ever, with 5 % of noise: what, sampling step, duration."""

RECORD: Final = Path(__file__).parents[2] / "examples" / "lynx_hare.csv"


def show(section: str, workers: int, max_time: float | None, seeds: Sequence[int]) -> Rows:
    """Run one of `SECTIONS`, print what came of it, and return that."""
    return SECTIONS[section][1](workers, max_time, seeds)


def _shown(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> Rows:
    say(table(heads, rows))
    return [dict(zip(heads, row, strict=True)) for row in rows]


def hard(workers: int, max_time: float | None, seeds: Sequence[int]) -> Rows:
    """Search input that no model fits, or that is hard to solve: what is said of it, and after how long."""
    rows: list[tuple[str, ...]] = []
    with searching(workers) as searches:
        for name, its in hard_cases(np.random.default_rng(seeds[0])).items():
            rows += _hard_rows(searches, name, its, max_time, seeds[0])
            note(f"{name}: {rows[-1][2]} after {rows[-1][1]} s")
    return _shown(("input", "s", "verdict", "reason", "equation"), rows)


def _hard_rows(
    searches: Searches, name: str, its: Table, max_time: float | None, seed: int
) -> list[tuple[str, str, str, str, str]]:
    job = attempt(searches, name, its, configured(seed, {}, {"max_time": max_time}), Stopwatch(HARD_LIMIT_S))
    if job.failure is not None:
        return [(name, f"{job.seconds:.1f}", "refused", job.failure, "-")]
    return [(name, f"{job.seconds:.1f}", *_verdict(equation)) for equation in job.result["equations"]]


def _verdict(equation: Mapping[str, Any]) -> tuple[str, str, str]:
    grade = equation.get("verdict") or ("converged" if equation.get("converged") else "not converged")
    text = clipped(shortened(equation.get("expression") or "-", 4), 60)
    return str(grade), clipped(equation.get("reason") or "-", 100), f"{equation['lhs']} = {text}"


def hard_cases(rng: np.random.Generator) -> dict[str, Table]:
    """Return tables by name: too few points, pure noise, states that explode, stiff systems."""
    noise = [(_grid(100), rng.standard_normal((100, 2))) for _ in range(4)]
    walks = [(_grid(100), np.cumsum(rng.standard_normal((100, 2)), axis=0)) for _ in range(4)]
    few = trajectories("lotka_volterra", 0.1, 0, 0.05)
    return {
        "4 points": _table([(few.times[0][:4], few.values[0][:4])]),
        "7 points": _table([(few.times[0][:7], few.values[0][:7])]),
        "12 points": _table([(few.times[0][:12], few.values[0][:12])]),
        "nothing but noise": _table(noise),
        "random walks": _table(walks),
        "explosion x' = x²": _with_noise(_explosions(), 0.02, rng),
        "growth x' = 2x to 5e8": _with_noise([_growth(rate) for rate in (1.0, 2.0)], 0.01, rng),
        "stiff, 1 to 1000": _with_noise([_linear_stiff(start) for start in ((1.0, 0.0), (2.0, 1.0))], 0.02, rng),
        "stiff oscillator": _with_noise([_relaxation(start) for start in ((2.0, 0.0), (1.0, 0.5))], 0.02, rng),
    }


Runs = Sequence[tuple[FloatArray, FloatArray]]


def _table(runs: Runs) -> Table:
    return table_of(Sampled(("x", "y"), tuple(times for times, _ in runs), tuple(values for _, values in runs)))


def _with_noise(runs: Runs, level: float, rng: np.random.Generator) -> Table:
    noisy = with_noise([values for _, values in runs], level, rng)
    return _table([(times, values) for (times, _), values in zip(runs, noisy, strict=True)])


def _grid(points: int) -> FloatArray:
    return np.arange(points, dtype=np.float64) * 0.1


def _explosions() -> Runs:
    """Return solutions of x' = x², y' = x - y until shortly before they end; x grows by a factor of 200."""
    return [_solved(lambda x, y: (x * x, x - y), (start, 1.0), 0.995 / start, 100) for start in (0.5, 1.0, 1.5)]


def _growth(start: float) -> tuple[FloatArray, FloatArray]:
    return _solved(lambda x, y: (2.0 * x, 1e-8 * x - y), (start, 1.0), 10.0, 100)


def _linear_stiff(start: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Return a solution of a linear system with eigenvalues -1 and -1000."""
    return _solved(lambda x, y: (998.0 * x + 1998.0 * y, -999.0 * x - 1999.0 * y), start, 5.0, 100)


def _relaxation(start: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    return _solved(lambda x, y: (200.0 * (y - x**3 / 3 + x), -x), start, 10.0, 100)


def _solved(
    field: Callable[[float, float], tuple[float, float]], start: tuple[float, float], duration: float, points: int
) -> tuple[FloatArray, FloatArray]:
    times = np.linspace(0.0, duration, points)
    solution = solve_ivp(
        lambda _, state: field(state[0], state[1]),
        (0.0, duration),
        start,
        method="LSODA",
        t_eval=times,
        rtol=1e-9,
        atol=1e-12,
    )
    return times, np.ascontiguousarray(solution.y.T)


def timing(workers: int, max_time: float | None, seeds: Sequence[int]) -> Rows:
    """Time whole jobs on 400 and on 100,000 rows of two states: preparing, searching, refining, memory."""
    rows: list[tuple[str, ...]] = []
    for name, step, duration in RECORDINGS:
        its = table_of(trajectories("predator_prey", step, seeds[0], 0.05, duration))
        stopwatch = Stopwatch(weighs=True)
        with searching(workers) as searches:
            result = searches.solve(name, its, configured(seeds[0], {}, {"max_time": max_time}), stopwatch.watch)
        rows.append((name, str(its.rows), *_times(result, stopwatch), f"{largest_child_mb():.0f}"))
        note(f"{name}: {result['seconds']:.1f} s")
    heads = ("data", "rows", "preparing s", "search s", "refining s", "job s", "all processes MB", "largest so far MB")
    return _shown(heads, rows)


def _times(result: Mapping[str, Any], stopwatch: Stopwatch) -> tuple[str, ...]:
    phases = [stopwatch.seconds.get(state, 0.0) for state in ("preparing", "running", "refining")]
    seconds = (f"{value:.1f}" for value in (*phases, result["seconds"]))
    return (*seconds, f"{stopwatch.most_memory_mb:.0f}")


DRIVEN: Final = {"x": "v", "v": "-0.3*v - sin(x) + 0.8*u"}
"""A damped pendulum that a measured torque drives; "v" is its velocity."""


def driven(workers: int, max_time: float | None, seeds: Sequence[int]) -> Rows:
    """Search a pendulum that a measured input drives, at three levels of noise."""
    rows: list[tuple[str, ...]] = []
    with searching(workers) as searches:
        for level in (0.0, 0.05, 0.1):
            for seed in seeds:
                key = Key("atoll", "plain", "driven pendulum", level, seed)
                outcome, _ = search(searches, key, driven_case(level, seed), max_time)
                for equation in outcome.equations:
                    found = ("yes", percent(equation.constants_error)) if equation.found else ("NO", "-")
                    r2 = "-" if equation.r2 is None else f"{equation.r2:.3f}"
                    text = clipped(shortened(equation.expression or "-", 4), 60) if equation.found else miss(equation)
                    rows.append(
                        (f"{level:g}", str(seed), equation.variable, *found, r2, f"{outcome.seconds:.1f}", text)
                    )
                note(f"{key.title}: {outcome.found} of {len(outcome.equations)} in {outcome.seconds:.1f} s")
    return _shown(("noise", "seed", "variable", "found", "constants", "R²", "s", "equation"), rows)


def driven_case(level: float, seed: int) -> Case:
    """Return four noisy trajectories of the driven pendulum with its input, each driven otherwise, and a fresh one."""
    rng = np.random.default_rng([seed, 10])
    courses = [_driven_course(rng) for _ in range(5)]
    *measured, fresh = courses
    noisy = with_noise([each.states for each in measured], level, rng)
    inputs = [np.array([each.inputs[0](time) for time in each.times.tolist()]) for each in measured]
    values = tuple(np.column_stack((states, signal)) for states, signal in zip(noisy, inputs, strict=True))
    sampled = Sampled(("x", "v", "u"), tuple(each.times for each in measured), values)
    clean = np.column_stack((np.concatenate([each.states for each in measured]), np.concatenate(inputs)))
    columns = dict(zip(sampled.names, clean.T, strict=True))
    return Case(table_of(sampled), DRIVEN, columns, fresh, {"inputs": ("u",)})


def _driven_course(rng: np.random.Generator) -> Course:
    """Return a trajectory of the driven pendulum under three sines of random frequency and phase."""
    times = _grid(100)
    rates, phases = rng.uniform(0.3, 2.5, 3), rng.uniform(0.0, 2.0 * math.pi, 3)
    spline = CubicSpline(times, np.sin(np.outer(times, rates) + phases).sum(axis=1))

    def torque(time: float) -> float:
        return float(spline(time))

    def slope(time: float, state: FloatArray) -> tuple[float, float]:
        return state[1], -0.3 * state[1] - math.sin(state[0]) + 0.8 * torque(time)

    start = (rng.uniform(-2.0, 2.0), rng.uniform(-1.0, 1.0))
    solution = solve_ivp(
        slope, (0.0, times[-1]), start, method="DOP853", t_eval=times, rtol=1e-10, atol=1e-12, max_step=0.05
    )
    return Course(times, np.ascontiguousarray(solution.y.T), (torque,))


def record(workers: int, max_time: float | None, seeds: Sequence[int]) -> Rows:
    """Search the lynx-hare record and print the model with its intervals, verdicts and simulation."""
    its = read_table([RECORD], DataConfig(time="year"))
    answers: Rows = []
    with searching(workers) as searches:
        for seed in seeds:
            result = searches.solve(
                f"lynx and hare seed {seed}", its, configured(seed, {"time": "year"}, {"max_time": max_time})
            )
            say(f"seed {seed}, {result['seconds']:.1f} s")
            say("\n".join(described(result)))
            answers.append(result)
    return answers


def described(result: Mapping[str, Any]) -> list[str]:
    """Return lines on the equations of `result`: constants with intervals, verdict, and the simulation's R²."""
    lines: list[str] = []
    for equation in result["equations"]:
        lines.append(f"{equation['lhs']} = {shortened(equation.get('expression') or '-', 4)}")
        for constant in equation.get("constants") or []:
            interval = constant.get("interval")
            spread = f" in [{interval[0]:.4g}, {interval[1]:.4g}]" if interval else ""
            unknown = ", not identifiable" if constant.get("identifiable") is False else ""
            lines.append(f"    {constant['value']:.4g}{spread}{unknown}")
        grade, reason, _ = _verdict(equation)
        lines.append(f"    {grade}: {reason}")
    return lines + _simulations(result)


def _simulations(result: Mapping[str, Any]) -> list[str]:
    """Return a line for each trajectory of the result's simulation, with R² by state."""
    simulation = result.get("simulation") or {}
    return [
        f"simulated {each.get('name', '')}{' (held out)' if each.get('held_out') else ''}: R² {each.get('r2')}"
        for each in simulation.get("trajectories") or []
    ]


SECTIONS: Final[dict[str, tuple[str, Section]]] = {
    "hard": ("input that no model fits: what is said of it, and after how long", hard),
    "timing": ("400 and 100,000 rows: seconds of each part, and memory", timing),
    "driven": ("a pendulum that a measured input drives", driven),
    "record": ("the lynx-hare record", record),
}
"""By option: its help, and what it does."""
