"""Python: a module that needs numpy alone, with its own integrator; processes by the method of Euler and Maruyama."""

import keyword
from typing import Final

from atoll.export.language import Language
from atoll.export.naming import Naming
from atoll_core.expression.text.infix import Notation

_WORDS: Final = "np sys t along parameters rates noise simulate main value PARAMETERS SIZES"

LANGUAGE: Final = Language(
    name="Python",
    # np.power is not a number where a Python power would be complex
    notation=Notation(prefix="np.", power="np.power({0}, {1})", natural="{0}**{1}", is_call=True),
    naming=Naming(frozenset([*keyword.kwlist, *keyword.softkwlist, *_WORDS.split()]), ("TABLE_", "UNTIL_")),
    time="t",
    comment="#",
    remark="  # {}",
    where_undefined="numbers are inf or nan, and a simulation ends with an ArithmeticError",
    has_noise=True,
    regression='''\
import numpy as np

PARAMETERS = {
$for constants:    '$name': $value,$remark
}


def value(<<inputs|$name, |>>parameters=PARAMETERS):
    """Return $target of numbers or arrays."""
$for constants:    $name = parameters['$name']
    return $formula
''',
    motion='''\
import sys

import numpy as np

STATES = (<<states|'$name'>>$comma_of_one)
START = np.array([<<states|$start>>])
$unless process:SIZES = np.array([<<states|$size>>])  # beside these errors are small
TIMES = np.linspace($first_time, $last_time, $rows)
PARAMETERS = {
$for constants:    '$name': $value,$remark
$for held:    '$name': $value,  # input
}
$for tables:
TABLE_$name = np.array([  # $about
$for cubics:    [$since, $c0, $c1, $c2, $c3],
])
UNTIL_$name = $until
$end
$if tables:


def along(table, until, t):
    """Return an input at time t: cubic between the times of its table, constant beyond."""
    t = min(max(t, table[0, 0]), until)
    begin, c0, c1, c2, c3 = table[np.searchsorted(table[:, 0], t, side="right") - 1]
    s = t - begin
    return c0 + s * (c1 + s * (c2 + s * c3))
$end


def rates(t, x, parameters=PARAMETERS):
    """Return dx/dt (D,) at time t and state x (D,)."""
    (<<states|$name>>$comma_of_one) = x
$for parameters:    $name = parameters['$name']
$for tables:    $name = along(TABLE_$name, UNTIL_$name, t)
    return np.array([
$for states:        $rate,  # $name
    ])
$if process:


def noise(t, x, parameters=PARAMETERS):
    """Return g (D, D) at time t and state x (D,): what multiplies dW."""
    (<<states|$name>>$comma_of_one) = x
$for parameters:    $name = parameters['$name']
$for tables:    $name = along(TABLE_$name, UNTIL_$name, t)
$for noise:    $name = $expression
    return np.array([
$for states:        [<<row|$root>>],
    ])
$end
$if process:


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
$end
$unless process:


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
$end


def main(until=None, steps=None):
    """Print a simulation as CSV, until a time, in so many steps."""
    until = TIMES[-1] if until is None else float(until)
    times = np.linspace(TIMES[0], until, int(steps or len(TIMES) - 1) + 1)
    print('$time', *STATES, sep=",")
    for t, row in zip(times.tolist(), simulate(times=times).tolist()):
        print(t, *row, sep=",")


if __name__ == "__main__":
    main(*sys.argv[1:])
''',
)
