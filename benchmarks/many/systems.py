"""Systems of many states: their true equations, and runs from random initial conditions.

Yeast glycolysis is that of Ruoff, Christensen, Wolf & Heinrich (Biophysical Chemistry 2003), with the rate laws by
which sparse methods are compared; its protocol: 40 runs of 51 points, 0.1 apart, initial conditions uniform in cubes of
width 1, 2 and 3 by turns. The others are textbook systems.
"""

import ast
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from scipy.integrate import solve_ivp

from atoll_core.data.dataset import FloatArray
from benchmarks.harness.systems import Sampled

Draw = Callable[[np.random.Generator, int], FloatArray]
"""The initial condition of a run, given its number; of order 2, positions and then velocities."""

_TOLERANCE: Final = 1e-11


@dataclass(frozen=True)
class System:
    """A system: by state, its true right side (infix text); `order` 2 has rates ``STATE_dot`` beside the states.

    A run has `points` rows, `step` apart.
    """

    name: str
    equations: Mapping[str, str]
    draw: Draw
    runs: int
    points: int
    step: float
    order: Literal[1, 2] = 1

    @property
    def states(self) -> tuple[str, ...]:
        """Names of what is measured."""
        return tuple(self.equations)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all variables of the equations."""
        return self.states if self.order == 1 else (*self.states, *(f"{state}_dot" for state in self.states))


def rates_of(system: System) -> Callable[[FloatArray], FloatArray]:
    """Return the function from all variables (V, ...) to the true right sides (S, ...)."""
    text = "[" + ", ".join(system.equations.values()) + "]"
    code = compile(ast.parse(text.replace("^", "**"), mode="eval"), system.name, "eval")
    space = {"__builtins__": {}, "sin": np.sin, "cos": np.cos, "exp": np.exp, "tanh": np.tanh}

    def rates(values: FloatArray) -> FloatArray:
        return np.array(eval(code, space, dict(zip(system.names, values, strict=True))))  # the texts below

    return rates


def sampled(system: System, seed: int, percent: float = 0.0) -> tuple[Sampled, FloatArray]:
    """Return the runs of a system with Gaussian noise, and all its variables (V, R) without.

    The noise of a state has so many percent of its standard deviation over all runs.
    """
    generator = np.random.default_rng(np.random.SeedSequence([seed, *system.name.encode()]))
    right_sides, count = rates_of(system), len(system.states)
    times = system.step * np.arange(system.points, dtype=np.float64)

    def field(_: float, values: FloatArray) -> FloatArray:
        slopes = right_sides(values)
        return slopes if system.order == 1 else np.concatenate([values[count:], slopes])

    runs = []
    for number in range(system.runs):
        start = system.draw(generator, number)
        solution = solve_ivp(field, (0.0, times[-1]), start, "LSODA", times, rtol=_TOLERANCE, atol=_TOLERANCE)
        runs.append(solution.y)
    whole = np.concatenate(runs, axis=1)
    deviations = whole[:count].std(axis=1)[:, None]
    noisy = [run[:count] + 0.01 * percent * deviations * generator.standard_normal((count, len(times))) for run in runs]
    return Sampled(system.states, (times,) * len(runs), tuple(states.T for states in noisy)), whole


_FLUX: Final = "x1*x6/(1 + (x6/0.52)^4)"
YEAST: Final = System(
    "yeast",
    {
        "x1": f"2.5 - 100*{_FLUX}",
        "x2": f"200*{_FLUX} - 6*x2 - 6*x2*x7",
        "x3": "6*x2 - 6*x2*x7 - 64*x3 + 16*x3*x6",
        "x4": "64*x3 - 16*x3*x6 - 13*x4 + 13*x5 - 100*x4*x7",
        "x5": "1.3*x4 - 3.1*x5",
        "x6": f"128*x3 - 32*x3*x6 - 1.28*x6 - 200*{_FLUX}",
        "x7": "6*x2 - 18*x2*x7 - 100*x4*x7",
    },
    lambda generator, number: (1 + number % 3) * generator.uniform(size=7),
    40,
    51,
    0.1,
)


def lorenz96(states: int) -> System:
    """Return the model of Lorenz (1996) with forcing 8."""
    name = [f"x{place + 1}" for place in range(states)]
    equations = {
        name[place]: f"{name[(place + 1) % states]}*{name[place - 1]} - {name[place - 2]}*{name[place - 1]}"
        f" - {name[place]} + 8"
        for place in range(states)
    }
    return System(
        f"lorenz96-{states}", equations, lambda generator, _: 8.0 * generator.uniform(size=states) - 2.0, 10, 201, 0.02
    )


def _repressilator() -> System:
    """Return three genes in a ring, each with its messenger (Elowitz & Leibler 2000)."""
    equations: dict[str, str] = {}
    for place in range(3):
        m, p, repressor = f"m{place + 1}", f"p{place + 1}", f"p{(place - 1) % 3 + 1}"
        equations |= {m: f"0.2 + 50/(1 + {repressor}^2) - {m}", p: f"2*{m} - 2*{p}"}
    return System("repressilator", equations, lambda generator, _: 10.0 * generator.uniform(size=6), 10, 201, 0.1)


def _sir() -> System:
    """Return an epidemic in three age groups: susceptible, infected and recovered shares of each."""
    contacts = ((1.6, 0.5, 0.2), (0.5, 0.9, 0.3), (0.2, 0.3, 0.6))
    recovery = (0.4, 0.3, 0.25)
    equations: dict[str, str] = {}
    for group, row in enumerate(contacts, 1):
        infection = " + ".join(f"{rate}*S{group}*I{other}" for other, rate in enumerate(row, 1))
        equations |= {
            f"S{group}": f"-({infection})",
            f"I{group}": f"{infection} - {recovery[group - 1]}*I{group}",
            f"R{group}": f"{recovery[group - 1]}*I{group}",
        }

    def draw(generator: np.random.Generator, _: int) -> FloatArray:
        infected = generator.uniform(0.0, 0.1, 3)
        recovered = generator.uniform(0.0, 0.4, 3)
        return np.column_stack([1.0 - infected - recovered, infected, recovered]).ravel()

    return System("sir", equations, draw, 10, 101, 0.2)


def _pendulums(count: int) -> System:
    """Return pendulums in a row, neighbours coupled by springs, in air."""
    equations: dict[str, str] = {}
    for place in range(count):
        angle = f"a{place + 1}"
        near = [f"a{other + 1}" for other in (place - 1, place + 1) if 0 <= other < count]
        springs = f"2*({' + '.join(near)}) - {2 * len(near)}*{angle}"
        equations[angle] = f"-9.81*sin({angle}) - 0.1*{angle}_dot + {springs}"

    def draw(generator: np.random.Generator, _: int) -> FloatArray:
        return np.concatenate([generator.uniform(-2.0, 2.0, count), generator.normal(size=count)])

    return System("pendulums", equations, draw, 10, 201, 0.02, 2)


SYSTEMS: Final = {
    system.name: system
    for system in (YEAST, *map(lorenz96, (8, 20, 40, 100)), _repressilator(), _sir(), _pendulums(10))
}
