"""The seven systems of Table III of Schmidt & Lipson 2008 and a damped pendulum, sampled from accurate solutions.

``python -m benchmarks.harness.systems --system lotka_volterra --step 0.02 --out DIR`` writes CSV files that
`coordinator run` reads; `trajectories`, `TRUTH` and `write_csv` are what the benchmarks and the tests import. Equations
are the paper's printed ones (its van der Pol differs from that of the published data files of the same name).
"""

from argparse import Namespace
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll_core.data.table import Table
from benchmarks.harness.command_line import option, program
from benchmarks.harness.jobs import table_of_columns
from benchmarks.harness.solving import DivergedError, solve

FloatArray = npt.NDArray[np.float64]
Draw = Callable[[np.random.Generator], tuple[float, float]]

RUNS: Final = 4
MAX_EVALUATIONS: Final = 2_000_000
LIMIT: Final = 1e6


@dataclass(frozen=True)
class System:
    """One system: `truth` maps each state to its right-hand side as sympy text, in the order of `field`'s states.

    `starts` are fixed initial conditions, else `draw` makes one; where there are both, `draw` makes those of fresh
    trajectories that models are judged by. `measured` are the states that are written.
    """

    truth: dict[str, str]
    field: Callable[[float, float], tuple[float, float]]
    draw: Draw | None = None
    starts: tuple[tuple[float, float], ...] = ()
    measured: tuple[str, ...] = ()

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the two states."""
        return tuple(self.truth)


@dataclass(frozen=True, eq=False)
class Sampled:
    """Trajectories of one system: `times[i]` (n,), `values[i]` (n, S) and `names` of the S measured states."""

    names: tuple[str, ...]
    times: tuple[FloatArray, ...]
    values: tuple[FloatArray, ...]


def _normal(x: float, y: float) -> Draw:
    """Initial conditions around (x, y) with the variances 10**0.1 and 10**0.01 of the published data sets."""
    return lambda rng: (x + 10**0.05 * rng.standard_normal(), y + 10**0.005 * rng.standard_normal())


def _uniform(low: tuple[float, float], high: tuple[float, float]) -> Draw:
    return lambda rng: (rng.uniform(low[0], high[0]), rng.uniform(low[1], high[1]))


def _respiration(x: float, y: float) -> tuple[float, float]:
    eaten = x * y / (1 + 0.5 * x * x)
    return 20 - x - eaten, 10 - eaten


SYSTEMS: Final[dict[str, System]] = {
    "glider": System(
        {"v": "-0.05*v**2 - sin(theta)", "theta": "v - cos(theta)/v"},
        lambda v, a: (-0.05 * v * v - np.sin(a), v - np.cos(a) / v),
        _normal(5.0, 0.0),
    ),
    "bacterial_respiration": System(
        {"x": "20 - x - x*y/(1 + 0.5*x**2)", "y": "10 - x*y/(1 + 0.5*x**2)"}, _respiration, _normal(5.0, 10.0)
    ),
    "predator_prey": System(
        {"x": "x*(4 - x - y/(1 + x))", "y": "y*(x/(1 + x) - 0.075*y)"},
        lambda x, y: (x * (4 - x - y / (1 + x)), y * (x / (1 + x) - 0.075 * y)),
        _normal(5.0, 10.0),
    ),
    "bar_magnets": System(
        {"theta1": "0.5*sin(theta1 - theta2) - sin(theta1)", "theta2": "0.5*sin(theta2 - theta1) - sin(theta2)"},
        lambda a, b: (0.5 * np.sin(a - b) - np.sin(a), 0.5 * np.sin(b - a) - np.sin(b)),
        _uniform((0.0, 0.0), (2 * np.pi, 2 * np.pi)),
    ),
    "shear_flow": System(
        {"theta": "cot(phi)*cos(theta)", "phi": "(cos(phi)**2 + 0.1*sin(phi)**2)*sin(theta)"},
        lambda a, p: (np.cos(a) / np.tan(p), (np.cos(p) ** 2 + 0.1 * np.sin(p) ** 2) * np.sin(a)),
        _uniform((-np.pi, -np.pi / 2), (np.pi, np.pi / 2)),
    ),
    "van_der_pol": System(
        {"x": "10*(y - (x**3/3 - x))", "y": "-x/10"},
        lambda x, y: (10 * (y - (x**3 / 3 - x)), -x / 10),
        _uniform((0.0, 0.0), (1.0, 1.0)),
    ),
    "lotka_volterra": System(
        {"x": "3*x - 2*x*y - x**2", "y": "2*y - x*y - y**2"},
        lambda x, y: (3 * x - 2 * x * y - x * x, 2 * y - x * y - y * y),
        _uniform((1.0, 1.0), (8.0, 3.0)),
        starts=((1.0, 3.0), (4.0, 1.0), (8.0, 2.0), (3.0, 3.0)),
    ),
    "pendulum": System(
        {"theta": "theta_dot", "theta_dot": "-0.1*theta_dot - sin(theta)"},
        lambda a, w: (w, -0.1 * w - np.sin(a)),
        starts=((0.5, 0.0), (1.5, 0.0), (2.5, 0.0), (-2.0, 1.0)),
        measured=("theta",),
    ),
}
"""By name, in the order of Table III; the pendulum, known by its angle alone, is ours."""

TABLE_III: Final = tuple(name for name in SYSTEMS if name != "pendulum")
TRUTH: Final = {name: system.truth for name, system in SYSTEMS.items()}
"""TRUTH[system][state] is the right-hand side as sympy text; for the pendulum "theta_dot" is the one to be found."""


def trajectories(system: str, step: float = 0.1, seed: int = 0, noise: float = 0.0, duration: float = 10.0) -> Sampled:
    """Return four sampled trajectories of `system`.

    Args:
        system: a name in `SYSTEMS`.
        step: sampling step in time units; round(duration / step) points per trajectory, the first one at time 0.
        seed: chooses the initial conditions (fixed ones excepted) and the noise.
        noise: standard deviation of Gaussian noise, as a fraction of each state's pooled standard deviation.
        duration: length of a trajectory in time units.
    """
    chosen = SYSTEMS[system]
    rng = np.random.default_rng(seed)
    times: FloatArray = np.arange(round(duration / step), dtype=np.float64) * step
    noisy = with_noise(solutions(chosen, [times] * RUNS, rng), noise, rng)
    measured = chosen.measured or chosen.states
    kept = [chosen.states.index(name) for name in measured]
    return Sampled(measured, tuple(times for _ in noisy), tuple(states[:, kept] for states in noisy))


def solutions(system: System, times: Sequence[FloatArray], rng: np.random.Generator) -> list[FloatArray]:
    """Return a solution (n, 2) at each of `times` (n,), from the fixed initial conditions and then from drawn ones."""
    fixed = [_solved(system, start, grid) for start, grid in zip(system.starts, times, strict=False)]
    return fixed + [drawn(system, rng, grid) for grid in times[len(fixed) :]]


def with_noise(clean: Sequence[FloatArray], noise: float, rng: np.random.Generator) -> list[FloatArray]:
    """Return `clean` with Gaussian noise of `noise` times the standard deviation of each state, all pooled."""
    spread = np.concatenate(clean).std(axis=0)
    return [states + noise * spread * rng.standard_normal(states.shape) for states in clean]


def drawn(system: System, rng: np.random.Generator, times: FloatArray) -> FloatArray:
    """Draw initial conditions until one has a solution that stays finite, and return that at `times`."""
    assert system.draw is not None
    while True:
        try:
            return _solved(system, system.draw(rng), times)
        except DivergedError:
            continue


def _solved(system: System, start: Sequence[float], times: FloatArray) -> FloatArray:
    """Return the solution from `start` at `times`, shape (n, 2); raises DivergedError."""
    return solve(
        lambda state: system.field(state[0], state[1]), start, times, limit=LIMIT, most_evaluations=MAX_EVALUATIONS,
        method="DOP853", rtol=1e-11, atol=1e-13, max_step=0.05,
    )  # fmt: skip


def table_of(sampled: Sampled) -> Table:
    """Return the table that a file with these trajectories would be read as."""
    values = np.concatenate(sampled.values).T
    columns = {"t": np.concatenate(sampled.times), **dict(zip(sampled.names, values, strict=True))}
    starts = np.cumsum([0, *map(len, sampled.times[:-1])]).tolist()
    return table_of_columns(columns, "sampled", starts)


def write_csv(path: Path, sampled: Sampled) -> None:
    """Write columns ``trajectory,t,states…`` with 17 significant digits."""
    lines = [",".join(("trajectory", "t", *sampled.names))]
    for number, (times, values) in enumerate(zip(sampled.times, sampled.values, strict=True), start=1):
        lines += [
            f"{number},{time:.10g}," + ",".join(f"{value:.17g}" for value in row)
            for time, row in zip(times.tolist(), values.tolist(), strict=True)
        ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


@program(
    "benchmarks.harness.systems",
    __doc__,
    option("--system", choices=SYSTEMS, default="lotka_volterra"),
    option("--all", action="store_true", help="every system, not only --system"),
    option("--step", type=float, default=0.1, help="sampling step (default 0.1)"),
    option("--duration", type=float, default=10.0, help="length of a trajectory (default 10)"),
    option("--seed", type=int, default=0, help="initial conditions and noise (default 0)"),
    option("--noise", type=float, default=0.0, help="as a fraction of each state's sd (default 0)"),
    option("--out", type=Path, default=Path(), help="folder to write to (default: this one)"),
)
def main(options: Namespace) -> None:
    """Write one CSV file per system asked for and print its path."""
    options.out.mkdir(parents=True, exist_ok=True)
    for name in SYSTEMS if options.all else (options.system,):
        path = options.out / f"{name}.csv"
        write_csv(path, trajectories(name, options.step, options.seed, options.noise, options.duration))
        print(path)


if __name__ == "__main__":
    main()
