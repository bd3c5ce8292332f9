"""Python: a module that needs numpy alone, with its own integrator; processes by the method of Euler and Maruyama."""

import keyword
from typing import Final

from atoll.export import integrators
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
'''
    + integrators.PYTHON,
)
