"""The tables: what is in the file, the words on the command line, the laws that the columns obey, or none.

Whether the data identify a law is decided here, before any search: not where fewer than five rows a period or fewer
than eight rows in all are left to tell it from others that are as short, and not where errors hide a term. Where
columns determine each other (their sum is constant, one is twice another), each law that agrees on the rows is right.
One module above 400 lines, since it is one list, an entry of a few lines for each table.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.text.parsing import from_infix
from benchmarks.first_hour.tables import (
    Columns,
    bouncing,
    closed,
    delayed,
    drawn,
    grid,
    heated,
    joined,
    mapped,
    noisy,
    scaled,
    solved,
    turning,
    without,
)

Laws = Mapping[str, str | None]
FEWEST_A_PERIOD: Final = 5
FEWEST_ROWS: Final = 8
SEEDS: Final = 5
"""Tables of each kind that is drawn at random without a law."""


@dataclass(frozen=True)
class Case:
    """One table: `make` returns its columns by plain name, `header` what some of them are called in the file.

    `laws` has the right-hand side of each state over the plain names, None for one that obeys none. `is_identified`
    says whether the rows tell the laws from others; `is_bound`, that columns determine each other. `clean` returns the
    columns without errors, and velocities where these are sought (`x_dot`); `tolerance`, a share of the derivative's
    size, is what a right law may miss it by. `words` stand on the command line.
    """

    name: str
    make: Callable[[], Columns]
    laws: Laws
    is_identified: bool = True
    is_bound: bool = False
    header: Mapping[str, str] = field(default_factory=dict)
    words: tuple[str, ...] = ()
    clean: Callable[[], Columns] | None = None
    tolerance: float = 0.01
    is_long: bool = False


TURNING: Final[Laws] = {"x": "v", "v": "-x"}
DECAY: Final[Laws] = {"y": "-0.5*y"}
PREY: Final[Laws] = {"x": "1.1*x - 0.4*x*y", "y": "0.1*x*y - 0.4*y"}
NONE: Final[Laws] = {"x": None}


def _prey(rows: int = 200, end: float = 20.0) -> Columns:
    return solved(
        lambda _, z: (1.1 * z[0] - 0.4 * z[0] * z[1], 0.1 * z[0] * z[1] - 0.4 * z[1]),
        "xy", (10.0, 5.0), np.linspace(0.0, end, rows),
    )  # fmt: skip


def _epidemic(rows: int = 120) -> Columns:
    return solved(
        lambda _, z: (-0.5 * z[0] * z[1], 0.5 * z[0] * z[1] - 0.1 * z[1], 0.1 * z[1]),
        "SIR", (0.99, 0.01, 0.0), np.linspace(0.0, 60.0, rows),
    )  # fmt: skip


EPIDEMIC: Final[Laws] = {"S": "-0.5*S*I", "I": "0.5*S*I - 0.1*I", "R": "0.1*I"}


def _decay(rows: int, step: float = 0.1) -> Columns:
    return closed(grid(rows, step), y=lambda t: 3.0 * np.exp(-0.5 * t))


def _falling(rows: int = 100) -> Columns:
    return closed(grid(rows, 0.02), h=lambda t: 100.0 + 3.0 * t - 4.905 * t * t, v=lambda t: 3.0 - 9.81 * t)


def _charged(rows: int = 200) -> Columns:
    """A capacitor behind a switch: x' = 2 u - x, u is 0 or 1, rows stand at the switches."""
    times = grid(rows, 0.05)
    u = np.where((times >= 2.0 - 1e-9) & (times < 6.0 - 1e-9), 1.0, 0.0)
    x, states = 0.5, [0.5]
    for switch in u[:-1].tolist():
        x = 2.0 * switch + (x - 2.0 * switch) * math.exp(-0.05)
        states.append(x)
    return {"t": times, "x": np.array(states), "u": u}


def _filled(rows: int = 200) -> Columns:
    """A tank behind a valve of 0 and 1: x' = 2 u."""
    times = grid(rows, 0.05)
    u = np.where((times % 2.0) < 1.0 - 1e-9, 1.0, 0.0)
    return {"t": times, "x": 1.0 + np.concatenate([[0.0], np.cumsum(2.0 * u[:-1] * 0.05)]), "u": u}


def _after_rest(rows: int = 200) -> Columns:
    """Rest at 1 for half of the rows, then x' = -0.8 x."""
    times = grid(rows, 0.1)
    start = times[rows // 2]
    return {"t": times, "x": np.where(times < start, 1.0, np.exp(-0.8 * (times - start)))}


def _driven(rows: int = 300) -> Columns:
    columns = solved(
        lambda t, z: (z[1], -4.0 * z[0] - 0.3 * z[1] + math.cos(1.3 * t)), "xv", (0.0, 1.0), grid(rows, 0.1)
    )
    return joined(columns, u=np.cos(1.3 * columns["t"]))


def _counts(factor: float) -> Columns:
    columns = _prey()
    return {name: values if name == "t" else np.rint(factor * values) for name, values in columns.items()}


def _shuffled(seed: int) -> Columns:
    columns = turning(40.0)
    order = np.random.default_rng(seed).permutation(len(columns["t"]))
    return {name: values if name == "t" else values[order] for name, values in columns.items()}


def _million(noise: float) -> Columns:
    times = grid(1_000_000, 0.001)
    columns = {"t": times, "x": np.exp(-0.001 * times) * np.cos(times)}
    columns["v"] = -0.001 * columns["x"] - np.exp(-0.001 * times) * np.sin(times)
    return noisy(columns, noise, 5) if noise else columns


def _damped(rows: int = 200, step: float = 0.1) -> Columns:
    return solved(lambda _, z: (z[1], -4.0 * z[0] - 0.4 * z[1]), "xv", (1.0, 0.0), grid(rows, step))


DAMPED: Final[Laws] = {"x": "v", "v": "-4*x - 0.4*v"}

IN_STEP: Final = (
    *(
        Case(f"{rows} rows a period", partial(turning, rows), TURNING, rows >= FEWEST_A_PERIOD, is_bound=True)
        for rows in (3, 4, 5, 6, 7, 8, 9, 10, 12, 15, 16, 20)
    ),
    Case("6 rows a period, a whole number of them", partial(turning, 6, 12), TURNING, is_bound=True),
    Case("10 rows a period, position alone", lambda: without(turning(10), "v"), {"x": "-x"}, words=("--order", "2"),
         clean=lambda: joined(turning(10), x_dot=turning(10)["v"])),
    Case("8 rows a period about 5", lambda: closed(grid(200, math.pi / 4.0), x=lambda t: 5.0 + np.cos(t),
         v=lambda t: -np.sin(t)), {"x": "v", "v": "5 - x"}, is_bound=True),
)  # fmt: skip

CLOSED_FORMS: Final = (
    Case("decay", partial(_decay, 100), DECAY),
    Case("growth", lambda: closed(grid(100, 0.1), y=lambda t: np.exp(0.3 * t)), {"y": "0.3*y"}),
    Case("growth, 1 % of noise", lambda: noisy(closed(grid(100, 0.1), y=lambda t: np.exp(0.3 * t)), 0.01, 1),
         {"y": "0.3*y"}, clean=lambda: closed(grid(100, 0.1), y=lambda t: np.exp(0.3 * t)), tolerance=0.1),
    Case("logistic growth", lambda: closed(grid(100, 0.1), y=lambda t: 10.0 / (1.0 + 9.0 * np.exp(-t))),
         {"y": "y - y*y/10"}),
    Case("ramp", lambda: closed(grid(100, 0.1), x=lambda t: 2.0 * t + 1.0), {"x": "2"}),
    Case("ramp down of whole numbers", lambda: closed(grid(100, 1.0), x=lambda t: 500.0 - 3.0 * t), {"x": "-3"}),
    Case("free fall", _falling, {"h": "v", "v": "-9.81"}, is_bound=True),
    Case("free fall, height alone", lambda: without(_falling(), "v"), {"h": "-9.81"}, words=("--order", "2"),
         clean=lambda: joined(_falling(), h_dot=_falling()["v"])),
    Case("hyperbola", lambda: closed(grid(100, 0.1), x=lambda t: 1.0 / (1.0 + t)), {"x": "-x*x"}),
    Case("square", lambda: closed(grid(100, 0.1), x=lambda t: (t + 1.0) ** 2, r=lambda t: t + 1.0),
         {"x": "2*r", "r": "1"}, is_bound=True),
    Case("tanh", lambda: closed(grid(120, 0.05) - 3.0, x=np.tanh), {"x": "1 - x*x"}),
    Case("Gauss curve beside its place", lambda: closed(grid(121, 0.05) - 3.0, x=lambda t: np.exp(-t * t),
         s=lambda t: t), {"x": "-2*s*x", "s": "1"}, is_bound=True),
    Case("spiral", _damped, DAMPED),
    Case("spiral, position alone", lambda: without(_damped(), "v"), {"x": "-4*x - 0.4*x_dot"}, words=("--order", "2"),
         clean=lambda: joined(_damped(), x_dot=_damped()["v"])),
    Case("relaxation to 20 degrees", lambda: closed(grid(60, 0.5), T=lambda t: 20.0 + 60.0 * np.exp(-0.2 * t)),
         {"T": "4 - 0.2*T"}),
    Case("two decays", lambda: closed(grid(100, 0.1), x=lambda t: np.exp(-t), y=lambda t: 5.0 * np.exp(-2.0 * t)),
         {"x": "-x", "y": "-2*y"}, is_bound=True),
    Case("square root", lambda: closed(grid(100, 0.05), x=lambda t: np.sqrt(1.0 + t)), {"x": "0.5/x"}),
    Case("cosine of any phase, three columns", lambda: joined(turning(31.7), z=np.exp(-0.1 * turning(31.7)["t"])),
         {**TURNING, "z": "-0.1*z"}, is_bound=True),
)  # fmt: skip

SOLUTIONS: Final = (
    Case("predator and prey", _prey, PREY),
    Case("predator and prey, 1 % of noise", lambda: noisy(_prey(), 0.01, 2), PREY, clean=_prey, tolerance=0.1),
    Case("van der Pol", lambda: solved(lambda _, z: (z[1], (1.0 - z[0] * z[0]) * z[1] - z[0]), "xv", (2.0, 0.0),
         np.linspace(0.0, 20.0, 400)), {"x": "v", "v": "(1 - x*x)*v - x"}),
    Case("Lorenz", lambda: solved(lambda _, z: (10.0 * (z[1] - z[0]), z[0] * (28.0 - z[2]) - z[1],
         z[0] * z[1] - 8.0 * z[2] / 3.0), "xyz", (-8.0, 8.0, 27.0), np.linspace(0.0, 10.0, 1000)),
         {"x": "10*(y - x)", "y": "x*(28 - z) - y", "z": "x*y - 2.6666666666666665*z"}),
    Case("pendulum", lambda: solved(lambda _, z: (z[1], -9.81 * math.sin(z[0])), "aw", (1.5, 0.0),
         np.linspace(0.0, 10.0, 300)), {"a": "w", "w": "-9.81*sin(a)"}),
    Case("enzyme", lambda: solved(lambda _, z: (-2.0 * z[0] / (0.5 + z[0]),), "s", (5.0,), np.linspace(0.0, 4.0, 100)),
         {"s": "-2*s/(0.5 + s)"}),
    Case("driven, the drive an input", _driven, {"x": "v", "v": "u - 4*x - 0.3*v"}, words=("--inputs", "u")),
    Case("draining tank", lambda: closed(grid(90, 0.1), h=lambda t: (2.0 - 0.1 * t) ** 2), {"h": "-0.2*sqrt(h)"},
         words=("--operators", "+,-,*,/,sqrt")),
)  # fmt: skip

WHOLE_NUMBERS: Final = (
    Case("animals counted by the thousand", partial(_counts, 1000.0),
         {"x": "1.1*x - 0.0004*x*y", "y": "0.0001*x*y - 0.4*y"}, clean=lambda: scaled(_prey(), x=1e3, y=1e3),
         tolerance=0.05),
    Case("animals counted by ones", partial(_counts, 10.0), {"x": "1.1*x - 0.04*x*y", "y": "0.01*x*y - 0.4*y"},
         clean=lambda: scaled(_prey(), x=10.0, y=10.0), tolerance=0.2),
    Case("doublings", lambda: closed(grid(30, 1.0), n=lambda t: 2.0**t), {"n": "0.6931471805599453*n"}),
    Case("Fibonacci numbers", lambda: closed(grid(40, 1.0), n=lambda t: np.rint(1.618033988749895 ** (t + 5.0)
         / math.sqrt(5.0))), {"n": "0.48121182505960347*n"}, tolerance=0.1),
    Case("squares of whole numbers", lambda: closed(grid(60, 1.0), x=lambda t: (t + 1.0) ** 2), {"x": "2*sqrt(x)"},
         words=("--operators", "+,-,*,/,sqrt")),
    Case("triangular numbers beside the row", lambda: closed(grid(50, 1.0), x=lambda t: t * (t + 1.0) / 2.0,
         n=lambda t: t), {"x": "n + 0.5", "n": "1"}, is_bound=True),
    Case("0 and 1 in turn", lambda: closed(grid(100, 1.0), x=lambda t: t % 2.0), NONE),
    Case("prime numbers", lambda: {"t": grid(95, 1.0), "x": np.array([float(n) for n in range(2, 500)
         if all(n % d for d in range(2, n))])}, NONE),
)  # fmt: skip

BOUND: Final = (
    Case("S + I + R = 1", _epidemic, EPIDEMIC, is_bound=True),
    Case("S + I + R = 1, 1 % of noise", lambda: noisy(_epidemic(), 0.01, 3), EPIDEMIC, is_bound=True, clean=_epidemic,
         tolerance=0.1),
    Case("S + I + R = 1000 persons", lambda: scaled(_epidemic(), S=1e3, I=1e3, R=1e3),
         {"S": "-0.0005*S*I", "I": "0.0005*S*I - 0.1*I", "R": "0.1*I"}, is_bound=True),
    Case("reaction, A + B = 1", lambda: closed(grid(80, 0.1), A=lambda t: np.exp(-0.7 * t),
         B=lambda t: 1.0 - np.exp(-0.7 * t)), {"A": "-0.7*A", "B": "0.7*A"}, is_bound=True),
    Case("A to B to C", lambda: solved(lambda _, z: (-z[0], z[0] - 0.5 * z[1], 0.5 * z[1]), "ABC", (1.0, 0.0, 0.0),
         grid(100, 0.1)), {"A": "-A", "B": "A - 0.5*B", "C": "0.5*B"}, is_bound=True),
    Case("a column twice", lambda: joined(_decay(100), z=_decay(100)["y"]), DECAY, is_bound=True),
    Case("a column and its double", lambda: joined(turning(31.7), w=2.0 * turning(31.7)["x"]), TURNING, is_bound=True),
    Case("metres and feet", lambda: joined(_prey(), z=3.28084 * _prey()["x"]), PREY, is_bound=True),
    Case("kelvin and degrees", lambda: closed(grid(60, 0.5), C=lambda t: 20.0 + 60.0 * np.exp(-0.2 * t),
         K=lambda t: 293.15 + 60.0 * np.exp(-0.2 * t)), {"C": "4 - 0.2*C", "K": "58.63 - 0.2*K"}, is_bound=True),
    Case("a constant column beside", lambda: joined(_decay(100), k=np.full(100, 7.0)), DECAY,
         words=("--states", "y", "--inputs", "k")),
    Case("a constant column among the states", lambda: joined(_decay(100), k=np.full(100, 7.0)), {**DECAY, "k": None},
         is_identified=False),
    Case("a column of zeros among the states", lambda: joined(_decay(100), k=np.zeros(100)), {**DECAY, "k": None},
         is_identified=False),
    Case("the number of the row beside", lambda: joined(_decay(100), row=np.arange(100.0)), {**DECAY, "row": "10"},
         is_bound=True),
)  # fmt: skip

RESTS_AND_STEPS: Final = (
    Case("charged through a switch of 0 and 1", _charged, {"x": "2*u - x"}, words=("--inputs", "u")),
    Case("filled through a valve of 0 and 1", _filled, {"x": "2*u"}, words=("--inputs", "u")),
    Case("rest, then decay", _after_rest, NONE),
    Case("decay to exact rest", lambda: closed(grid(200, 0.1), x=lambda t: np.maximum(2.0 - 0.2 * t, 0.0)), NONE),
    Case("decay until zeros", lambda: closed(grid(300, 0.5), y=lambda t: np.round(3.0 * np.exp(-0.5 * t), 4)), DECAY,
         clean=lambda: closed(grid(300, 0.5), y=lambda t: 3.0 * np.exp(-0.5 * t)), tolerance=0.05),
    Case("staircase", lambda: closed(grid(200, 0.1), x=lambda t: np.floor(t / 2.0)), NONE),
    Case("triangle wave", lambda: closed(grid(200, 0.1), x=lambda t: np.abs((t % 2.0) - 1.0)), NONE),
    Case("a room with a thermostat, heater known", partial(heated, 300, 0.2), {"T": "2 - 0.2*T + 4*u"},
         words=("--inputs", "u"), tolerance=0.05, is_identified=False),
)  # fmt: skip
NAMES: Final = tuple(
    Case(f"called {', '.join(header.values())}", make, laws, header=header, is_bound=make is turning, words=words)
    for make, laws, header, words in (
        (partial(turning, 31.7), TURNING, {"x": "sin", "v": "cos"}, ()),
        (partial(turning, 31.7), TURNING, {"x": "sint", "v": "cost"}, ()),
        (_prey, PREY, {"x": "sin_theta", "y": "cos_theta"}, ()),
        (_prey, PREY, {"x": "lambda", "y": "class"}, ()),
        (_prey, PREY, {"x": "e", "y": "pi"}, ()),
        (_prey, PREY, {"x": "E", "y": "I"}, ()),
        (_prey, PREY, {"x": "exp", "y": "expo"}, ()),
        (_prey, PREY, {"x": "N", "y": "S"}, ()),
        (_prey, PREY, {"x": "hare (thousands)", "y": "lynx [1/km^2]"}, ()),
        (_prey, PREY, {"x": "m", "y": "kg"}, ()),
        (_prey, PREY, {"x": "pH", "y": "dT"}, ()),
        (_prey, PREY, {"x": "dx", "y": "x"}, ()),
        (_prey, PREY, {"x": "None", "y": "nan"}, ()),
        (_prey, PREY, {"x": "1st", "y": "2nd"}, ()),
        (_prey, PREY, {"x": "prey, grey", "y": "größe"}, ()),
        (_prey, PREY, {"t": "elapsed time [s]"}, ("--time", "elapsed time")),
    )
)

SHORT: Final = (
    *(
        Case(f"decay, {rows} rows", partial(_decay, rows, 8.0 / rows), DECAY, is_identified=rows >= FEWEST_ROWS)
        for rows in (3, 4, 5, 6, 7, 8, 10, 12)
    ),
    Case("spiral, 12 rows", partial(_damped, 12, 0.4), DAMPED, is_identified=False),
    Case("white noise, 8 rows", lambda: drawn(8, 31, x="white"), NONE),
    Case("white noise, 12 rows", lambda: drawn(12, 32, x="white"), NONE),
    Case("two columns of white noise, 12 rows", lambda: drawn(12, 33, x="white", y="white"), {"x": None, "y": None}),
    Case("random walk, 12 rows", lambda: drawn(12, 34, x="walk"), NONE),
)

SIZES: Final = (
    Case("1e-30 beside 1e30", lambda: scaled(_damped(), x=1e-30, v=1e30), {"x": "1e-60*v", "v": "-4e60*x - 0.4*v"}),
    Case("animals by 1e-30 and 1e30", lambda: scaled(_prey(), x=1e-30, y=1e30),
         {"x": "1.1*x - 4e-31*x*y", "y": "1e29*x*y - 0.4*y"}),
    Case("decay from 1e-30", lambda: scaled(_decay(100), y=1e-30), DECAY),
    Case("decay from 1e30", lambda: scaled(_decay(100), y=1e30), DECAY),
    Case("decay in nanoseconds", lambda: scaled(_decay(100), t=1e-9), {"y": "-5e8*y"}),
    Case("decay over millions of years", lambda: scaled(_decay(100), t=3e13), {"y": "-1.6666666666666667e-14*y"}),
    Case("small swing about a million", lambda: closed(grid(200, 0.2), x=lambda t: 1e6 + np.cos(t),
         v=lambda t: -np.sin(t)), {"x": "v", "v": "1e6 - x"}, is_bound=True),
    Case("a million rows", partial(_million, 0.0), {"x": "v", "v": "-1.000001*x - 0.002*v"}, is_long=True),
    Case("a million rows, 5 % of noise", partial(_million, 0.05), {"x": "v", "v": "-1.000001*x - 0.002*v"},
         clean=partial(_million, 0.0), tolerance=0.1, is_long=True),
)  # fmt: skip

WAVES: Final[Mapping[str, Callable[[FloatArray], FloatArray]]] = {
    "u": lambda t: np.sin(0.7 * t) + 0.5 * np.cos(1.9 * t),
    "w": lambda t: 0.3 * np.cos(1.2 * t),
}
"""Inputs of recordings, by name."""


def _inputs(laws: Mapping[str, str]) -> tuple[str, ...]:
    return tuple(name for name in WAVES if any(name in law for law in laws.values()))


def _recording(laws: Mapping[str, str], start: tuple[float, ...], step: float, noise: float = 0.02) -> Columns:
    """Return 2,000 rows of what obeys these laws, with as much noise, and the inputs that they name without any."""
    inputs = _inputs(laws)
    programs = [from_infix(law, (*laws, *inputs)) for law in laws.values()]

    def rates(time: float, states: FloatArray) -> list[float]:
        waves = [float(WAVES[name](np.array(time))) for name in inputs]
        columns = np.array([*states, *waves])[:, None]
        return [float(values_of(program, columns)[0]) for program in programs]

    columns = noisy(solved(rates, "".join(laws), start, grid(2000, step)), noise, 6)
    return joined(columns, **{name: WAVES[name](columns["t"]) for name in inputs})


RECORDINGS: Final = tuple(
    Case(f"a recording of {title}", partial(_recording, laws, start, step), laws, is_long=True,
         words=("--inputs", ",".join(_inputs(laws))) if _inputs(laws) else (),
         clean=partial(_recording, laws, start, step, 0.0), tolerance=0.05)
    for title, laws, start, step in (
        ("a pendulum", {"x": "v", "v": "-sin(x)"}, (2.5, 0.0), 0.05),
        ("a damped swing", {"x": "v", "v": "-2*x - 0.1*v"}, (1.0, 0.0), 0.02),
        ("hunters and prey", {"x": "x - x*y", "y": "x*y - y"}, (2.5, 1.0), 0.05),
        ("a relaxation", {"x": "v", "v": "v - x*x*v - x"}, (2.5, 0.0), 0.05),
        ("a driven swing", {"x": "v", "v": "u - 2*x - 0.3*v"}, (1.0, 0.0), 0.05),
        ("a driven double well", {"x": "v", "v": "x - x*x*x - 0.2*v + w"}, (1.0, 0.0), 0.05),
        ("a reactor", {"x": "1 + x*x*y - 4*x", "y": "3*x - x*x*y"}, (1.0, 1.0), 0.02),
        ("a nerve", {"V": "V - V*V*V/3 - R + 0.5", "R": "0.08*V + 0.056 - 0.064*R"}, (1.0, 1.0), 0.1),
        ("an enzyme", {"s": "-1.2*s/(0.5 + s)"}, (5.0,), 0.004),
        ("growth with a limit", {"n": "0.8*n - 0.26666666666666666*n*n"}, (0.1,), 0.006),
        ("an epidemic", {"S": "-0.5*S*I", "I": "0.5*S*I - 0.1*I"}, (0.99, 0.01), 0.04),
        ("two masses", {"x": "v", "v": "y - 3*x", "y": "z", "z": "x - 2*y"}, (1.0, 0.0, 0.0, 0.5), 0.05),
        ("two clocks", {"a": "0.3 - sin(a - b)", "b": "sin(a - b) - 0.1"}, (2.8, 0.0), 0.008),
        ("a glider", {"v": "-0.05*v*v - sin(a)", "a": "v - cos(a)/v"}, (1.5, 0.1), 0.008),
    )
)  # fmt: skip
"""Longer than what is simulated at a stretch."""

LAWLESS: Final = (
    *(
        Case(f"{title}, seed {seed}", partial(drawn, 200, seed, **kinds), dict.fromkeys(kinds))
        for title, kinds in (
            ("white noise", {"x": "white"}),
            ("two columns of white noise", {"x": "white", "y": "white"}),
            ("uniform numbers", {"x": "uniform"}),
            ("random walk", {"x": "walk"}),
            ("two random walks", {"x": "walk", "y": "walk"}),
            ("a price", {"x": "growth"}),
        )
        for seed in range(SEEDS)
    ),
    Case("dice", lambda: drawn(200, 41, x="dice"), NONE),
    Case("Poisson counts", lambda: drawn(200, 42, x="counts"), NONE),
    Case("red noise", lambda: drawn(300, 43, x="red"), NONE),
    Case("an oscillation, rows shuffled", partial(_shuffled, 44), {"x": None, "v": None}),
    Case("logistic map", partial(mapped, lambda x: 3.9 * x * (1.0 - x), 0.3), NONE),
    Case("tent map", partial(mapped, lambda x: 1.99 * min(x, 1.0 - x), 0.3), NONE),
    Case("one cosine, its position alone", lambda: closed(grid(200, 0.2), x=np.cos), NONE),
    Case("two cosines, one column", lambda: closed(grid(300, 0.1), x=lambda t: np.cos(t) + np.cos(2.3 * t)), NONE),
    Case("two strangers", lambda: closed(grid(300, 0.1), x=np.cos, y=lambda t: np.cos(math.sqrt(2.0) * t)),
         {"x": None, "y": None}),
    Case("delayed feedback", partial(delayed, lambda _, past: -1.5 * past, 1.0, 300, 0.1, 1.0), NONE),
    Case("Mackey and Glass", partial(delayed, lambda x, past: 0.2 * past / (1.0 + past**10) - 0.1 * x, 17.0, 400, 1.0,
         0.9), NONE),
    Case("bouncing ball", partial(bouncing, 300, 0.01), {"h": "v", "v": None}, is_identified=False),
    Case("bouncing ball, height alone", lambda: without(bouncing(300, 0.01), "v"), {"h": None}, words=("--order", "2")),
    Case("a room with a thermostat, heater unknown", lambda: without(heated(300, 0.2), "u"), {"T": None}),
)  # fmt: skip

GROUPS: Final = {
    "in step with the period": IN_STEP,
    "closed forms": CLOSED_FORMS,
    "exact solutions": SOLUTIONS,
    "whole numbers": WHOLE_NUMBERS,
    "columns that determine each other": BOUND,
    "rests and steps": RESTS_AND_STEPS,
    "names": NAMES,
    "few rows": SHORT,
    "sizes": SIZES,
    "long recordings": RECORDINGS,
    "no law": LAWLESS,
}
CASES: Final = {case.name: case for cases in GROUPS.values() for case in cases}
