"""Python: a module that needs numpy alone, with its own integrator; processes by the method of Euler and Maruyama."""

import keyword
from typing import Final

from atoll.export.content import Content, Language, Wording
from atoll.export.naming import Naming
from atoll_core.expression.text.notation import PYTHON

_OWN: Final = {
    "np",
    "sys",
    "t",
    "along",
    "parameters",
    "rates",
    "noise",
    "simulate",
    "main",
    "value",
    "PARAMETERS",
    "SIZES",
}

LANGUAGE: Final = Language(
    PYTHON,
    Naming(frozenset({*keyword.kwlist, *keyword.softkwlist, *_OWN}), ("TABLE_", "UNTIL_")),
    "t",
    "#",
    "numbers are inf or nan, and a simulation ends with an ArithmeticError",
)


def write(content: Content) -> str:
    """Return the source of a module."""
    words = Wording(content, LANGUAGE)
    its = _regression(words) if not content.states else _motion(words)
    return "\n".join([*words.heading(), "", *its]) + "\n"


def _regression(words: Wording) -> list[str]:
    arguments = [words[each.name] for each in words.content.inputs]
    lines = ["import numpy as np", "", *_parameters(words, []), "", ""]
    lines += [f"def value({', '.join([*arguments, 'parameters=PARAMETERS'])}):"]
    lines += [
        f'    """Return {words.target} of numbers or arrays."""',
        *_taken(words, []),
        f"    return {words.rates[0]}",
    ]
    return lines


def _motion(words: Wording) -> list[str]:
    its = words.content
    held = [(words[each.name], each.value) for each in its.held]
    lines = ["import sys", "", "import numpy as np", "", f"STATES = ({_listed(map(repr, words.states))})"]
    lines += [f"START = np.array([{', '.join(map(repr, its.start))}])"]
    if its.sizes:
        lines += [f"SIZES = np.array([{', '.join(map(repr, its.sizes))}])  # beside these errors are small"]
    lines += [f"TIMES = np.linspace({its.begin!r}, {its.end!r}, {its.steps + 1})", *_parameters(words, held)]
    for each in its.tables:
        assert each.table is not None
        rows = [f"    [{', '.join(map(repr, row))}]," for row in each.table.tolist()]
        lines += [f"TABLE_{words[each.name]} = np.array([  # {words.about(each)}", *rows, "])"]
        lines += [f"UNTIL_{words[each.name]} = {each.until!r}"]
    lines += _ALONG.splitlines() if its.tables else []
    lines += ["", "", "def rates(t, x, parameters=PARAMETERS):"]
    lines += ['    """Return dx/dt (D,) at time t and state x (D,)."""', *_given(words, [name for name, _ in held])]
    lines += [
        "    return np.array([",
        *(f"        {text},  # {name}" for name, text in zip(words.states, words.rates, strict=True)),
    ]
    lines += ["    ])", *(_noise(words, [name for name, _ in held]) if its.covariance else [])]
    lines += (_PATHS if its.covariance else _INTEGRATOR).splitlines()
    return [*lines, *_MAIN.replace("TIME_NAME", repr(words.time)).splitlines()]


def _noise(words: Wording, held: list[str]) -> list[str]:
    assignments, rows = words.noise
    lines = ["", "", "def noise(t, x, parameters=PARAMETERS):"]
    lines += ['    """Return g (D, D) at time t and state x (D,): what multiplies dW."""', *_given(words, held)]
    lines += [f"    {name} = {text}" for name, text in assignments]
    return [
        *lines,
        "    return np.array([",
        *(f"        [{', '.join(each or '0.0' for each in row)}]," for row in rows),
        "    ])",
    ]


def _parameters(words: Wording, held: list[tuple[str, float]]) -> list[str]:
    lines = ["PARAMETERS = {"]
    for each in words.content.constants:
        note = words.note(each)
        lines.append(f"    {words[each]!r}: {each.value!r}," + (f"  # {note}" if note else ""))
    lines += [f"    {name!r}: {value!r},  # input" for name, value in held]
    return [*lines, "}"]


def _given(words: Wording, held: list[str]) -> list[str]:
    """Return the lines in a function that give every name its value."""
    lines = [f"    ({_listed(words.states)}) = x", *_taken(words, held)]
    names = [words[each.name] for each in words.content.tables]
    return lines + [f"    {name} = along(TABLE_{name}, UNTIL_{name}, t)" for name in names]


def _taken(words: Wording, held: list[str]) -> list[str]:
    names = [*(words[each] for each in words.content.constants), *held]
    return [f"    {name} = parameters[{name!r}]" for name in names]


def _listed(names: object) -> str:
    its = list(names)  # type: ignore[call-overload]
    return ", ".join(its) + ("," if len(its) == 1 else "")


_ALONG: Final = '''

def along(table, until, t):
    """Return an input at time t: cubic between the times of its table, constant beyond."""
    t = min(max(t, table[0, 0]), until)
    begin, c0, c1, c2, c3 = table[np.searchsorted(table[:, 0], t, side="right") - 1]
    s = t - begin
    return c0 + s * (c1 + s * (c2 + s * c3))
'''

_INTEGRATOR: Final = '''

NODES = np.array([0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1, 1])
WEIGHTS = np.array([
    [0, 0, 0, 0, 0, 0],
    [1 / 5, 0, 0, 0, 0, 0],
    [3 / 40, 9 / 40, 0, 0, 0, 0],
    [44 / 45, -56 / 15, 32 / 9, 0, 0, 0],
    [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0, 0],
    [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0],
    [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
])
ERRORS = np.array([71 / 57600, 0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40])


def simulate(start=START, times=TIMES, parameters=PARAMETERS, tolerance=1e-12):
    """Return the states (N, D) at N ascending times, from the state start (D,) at the first of them.

    By the pair of orders 5 and 4 of Dormand and Prince (1980); a step has a relative error of about tolerance. Raises
    ArithmeticError where the solution does not go on, or by more than a million steps only: a model as stiff as that
    wants an implicit method, such as scipy.integrate.solve_ivp(rates, ..., method="LSODA").
    """
    x, t = np.array(start, dtype=float), float(times[0])
    found, count, stages = [x], 0, np.empty((7, len(x)))
    with np.errstate(all="ignore"):
        stages[0] = rates(t, x, parameters)
        span = times[-1] - t
        least = tolerance * np.where(x == 0.0, SIZES, np.minimum(np.abs(x), SIZES))
        step = 1e-4 * span
        for end in times[1:]:
            while t < end:
                count += 1
                if count > 1_000_000 or not np.isfinite(stages[0]).all() or t + step == t:
                    raise ArithmeticError(f"the solution does not go on beyond time {float(t)!r}")
                h = min(step, end - t)
                for k in range(1, 7):
                    moved = x + h * (WEIGHTS[k, :k] @ stages[:k])
                    stages[k] = rates(t + NODES[k] * h, moved, parameters)
                bounds = least + tolerance * np.maximum(np.abs(x), np.abs(moved))
                size = np.abs(h * (ERRORS @ stages) / bounds).max()
                if not size <= 1.0:
                    step = h * max(0.2, 0.9 * size**-0.2) if np.isfinite(size) else 0.2 * h
                    continue
                t, x = end if h == end - t else t + h, moved
                stages[0] = stages[6]
                grown = h * min(5.0, 0.9 * max(size, 1e-10) ** -0.2)
                step = max(step, grown) if h < step else grown
            found.append(x)
    return np.array(found)
'''

_PATHS: Final = '''

def simulate(start=START, times=TIMES, parameters=PARAMETERS, seed=0, substeps=100):
    """Return one path (N, D) at N ascending times, from the state start (D,) at the first of them.

    By the method of Euler and Maruyama, in so many substeps between two times.
    """
    random, x, found = np.random.default_rng(seed), np.array(start, dtype=float), []
    found.append(x)
    with np.errstate(all="ignore"):
        for begin, end in zip(times[:-1], times[1:]):
            h = (end - begin) / substeps
            for k in range(substeps):
                t, normal = begin + k * h, random.standard_normal(len(x))
                x = x + h * rates(t, x, parameters) + np.sqrt(h) * (noise(t, x, parameters) @ normal)
            if not np.isfinite(x).all():
                raise ArithmeticError(f"the path does not go on beyond time {float(begin)!r}")
            found.append(x)
    return np.array(found)
'''

_MAIN: Final = '''

def main(until=None, steps=None):
    """Print a simulation as CSV, until a time, in so many steps."""
    until = TIMES[-1] if until is None else float(until)
    times = np.linspace(TIMES[0], until, int(steps or len(TIMES) - 1) + 1)
    print(TIME_NAME, *STATES, sep=",")
    for t, row in zip(times.tolist(), simulate(times=times).tolist()):
        print(t, *row, sep=",")


if __name__ == "__main__":
    main(*sys.argv[1:])
'''
