"""The languages of exports, with their reserved words, notation and templates.

Exports in Python and C contain an integrator (Dormand and Prince, orders 5 and 4). Exports in Julia, MATLAB, Modelica
and XPPAUT use the solvers of their tools. `atoll.export.language` describes the templates.
"""

import keyword
from typing import Final

from atoll.export.language import Language, Naming
from atoll_core.expression.operators import ABS, LOG, SQRT
from atoll_core.expression.text.infix import Notation

_PYTHON_WORDS: Final = "np sys t along parameters rates noise observe simulate main value PARAMETERS SIZES"

PYTHON: Final = Language(
    name="Python",
    # np.power returns NaN where a Python power would be complex
    notation=Notation(prefix="np.", power="np.power({0}, {1})", natural="{0}**{1}", is_call=True),
    naming=Naming(frozenset([*keyword.kwlist, *keyword.softkwlist, *_PYTHON_WORDS.split()]), ("TABLE_", "UNTIL_")),
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
$unless process:SIZES = np.array([<<states|$size>>])  # sizes of the states, for absolute tolerances
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
    """Return an input at time t: cubic between the times of its table, constant before and after."""
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
$if observed:


def observe(t, x, parameters=PARAMETERS):
    """Return the measured columns that are computed from a state x (D,) at time t."""
    (<<states|$name>>$comma_of_one) = x
$for parameters:    $name = parameters['$name']
$for tables:    $name = along(TABLE_$name, UNTIL_$name, t)
    return np.array([
$for observed:        $value,  # $name
    ])
$end
$if process:


def noise(t, x, parameters=PARAMETERS):
    """Return g (D, D), the factor of dW, at time t and state x (D,)."""
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

    The Euler-Maruyama method takes `substeps` equal steps between two times.
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
                raise ArithmeticError(f"the path cannot be continued after time {float(begin)!r}")
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

    The method is the pair of orders 5 and 4 of Dormand and Prince (1980). A step has a relative error of about
    `tolerance`. Raises ArithmeticError if the solution ends early or needs more than a million steps. Such a stiff
    model needs an implicit method, for example scipy.integrate.solve_ivp(rates, ..., method="LSODA").
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
                    raise ArithmeticError(f"the solution cannot be continued after time {float(t)!r}")
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
    """Print a simulation as CSV, up to the time `until`, in this number of equal `steps`."""
    until = TIMES[-1] if until is None else float(until)
    times = np.linspace(TIMES[0], until, int(steps or len(TIMES) - 1) + 1)
    print('$time', *STATES, sep=",")
    for t, row in zip(times.tolist(), simulate(times=times).tolist()):
        print(t, *row, sep=",")


if __name__ == "__main__":
    main(*sys.argv[1:])
''',
)


_C_WORDS: Final = (
    "auto break case char const continue default do double else enum extern float for goto if inline int long "
    "register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while "
    "bool true false asm typeof nullptr constexpr main errno stdin stdout stderr NULL EOF INFINITY NAN HUGE_VAL "
    "isnan isfinite sin cos tan exp log sqrt fabs tanh pow fmin fmax exit printf fprintf strtod strtol t state rate "
    "rates observe column simulate along parameters value SIZE sizes"
)
_C_MACROS: Final = (
    "BIG_ENDIAN BUFSIZ BYTE_ORDER EXIT_FAILURE EXIT_SUCCESS FD_SETSIZE FILENAME_MAX FOPEN_MAX FP_ILOGB0 FP_ILOGBNAN "
    "FP_INFINITE FP_NAN FP_NORMAL FP_SUBNORMAL FP_ZERO HUGE HUGE_VALF HUGE_VALL LITTLE_ENDIAN L_ctermid L_cuserid "
    "L_tmpnam MATH_ERREXCEPT MATH_ERRNO MAXFLOAT MB_CUR_MAX M_1_PI M_2_PI M_2_SQRTPI M_E M_LN10 M_LN2 M_LOG10E "
    "M_LOG2E M_PI M_PI_2 M_PI_4 M_SQRT1_2 M_SQRT2 NFDBITS PDP_ENDIAN P_tmpdir RAND_MAX SEEK_CUR SEEK_END SEEK_SET "
    "TMP_MAX WCONTINUED WEXITED WNOHANG WNOWAIT WSTOPPED WUNTRACED math_errhandling linux unix DOMAIN OVERFLOW PLOSS "
    "SING TLOSS UNDERFLOW X_TLOSS"
)
"""Names in the included headers: a column of the same name would clash with them."""

C: Final = Language(
    name="C",
    notation=Notation({ABS: "fabs"}, power="pow({0}, {1})", natural="pow({0}, {1})", is_call=True),
    naming=Naming(frozenset([*_C_WORDS.split(), *_C_MACROS.split()]), ("table_",)),
    time="t",
    comment="//",
    remark=", {}",
    where_undefined="numbers are inf or nan, and the simulation ends with a message and exit code 1",
    usage="Compile with: cc -std=c99 -O2 -ffp-contract=off model.c -lm. Run with: ./a.out [until [steps]].",
    regression="""\
#include <math.h>

$if constants:
static double parameters[$parameters] = {
$for constants:    $value, // $name$remark
};
$end
// $target
$if inputs:double value(<<inputs|double $name>>)
$unless inputs:double value(void)
{
$for parameters:    const double $name = parameters[$place];
    return $formula;
}
""",
    motion="""\
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#define SIZE $states

static const double start[SIZE] = {<<states|$start>>};
// sizes of the states, for absolute tolerances
static const double sizes[SIZE] = {<<states|$size>>};
static const double begin_time = $first_time, end_time = $last_time;
static const long step_count = $steps;
$if parameters:
static double parameters[$parameters] = {
$for constants:    $value, // $name$remark
$for held:    $value, // $name, input
};
$end
$if tables:

// An input at time t: cubic between the times of its table, constant before and after.
static double along(const double table[][5], long rows, double until, double t)
{
    long low = 0, high = rows;
    t = fmin(fmax(t, table[0][0]), until);
    while (high - low > 1) {
        const long middle = (low + high) / 2;
        if (table[middle][0] <= t)
            low = middle;
        else
            high = middle;
    }
    const double s = t - table[low][0];
    return table[low][1] + s * (table[low][2] + s * (table[low][3] + s * table[low][4]));
}
$end
$for tables:

// $about
static const double table_$name[$cubics][5] = {
$for cubics:    {$since, $c0, $c1, $c2, $c3},
};
$end

// the rate dx/dt at time t and a state
static void rates(double t, const double state[SIZE], double rate[SIZE])
{
$for states:    const double $name = state[$place];
$for parameters:    const double $name = parameters[$place];
$for tables:    const double $name = along(table_$name, $cubics, $until, t);
    (void)(t);
$for states:    (void)($name);
$for states:    rate[$place] = $rate;
}

$if observed:
// the measured columns that are computed from a state at time t
void observe(double t, const double state[SIZE], double column[$observed])
{
$for states:    const double $name = state[$place];
$for parameters:    const double $name = parameters[$place];
$for tables:    const double $name = along(table_$name, $cubics, $until, t);
    (void)(t);
$for states:    (void)($name);
$for observed:    column[$place] = $value; // $about
}

$end
// The pair of orders 5 and 4 of Dormand and Prince (1980).
static const double nodes[7] = {0, 1.0 / 5, 3.0 / 10, 4.0 / 5, 8.0 / 9, 1, 1};
static const double weights[7][6] = {
    {0},
    {1.0 / 5},
    {3.0 / 40, 9.0 / 40},
    {44.0 / 45, -56.0 / 15, 32.0 / 9},
    {19372.0 / 6561, -25360.0 / 2187, 64448.0 / 6561, -212.0 / 729},
    {9017.0 / 3168, -355.0 / 33, 46732.0 / 5247, 49.0 / 176, -5103.0 / 18656},
    {35.0 / 384, 0, 500.0 / 1113, 125.0 / 192, -2187.0 / 6784, 11.0 / 84},
};
static const double errors[7] = {71.0 / 57600,      0,         -71.0 / 16695, 71.0 / 1920,
                                 -17253.0 / 339200, 22.0 / 525, -1.0 / 40};
static const double tolerance = 1e-12; // approximate relative error of a step

// Integrate from time *t to time end with steps of about *step; stages[0] has the rates at *t. Returns 0 on failure.
static int advance(double *t, double end, double x[SIZE], double stages[7][SIZE], double *step,
                   const double least[SIZE])
{
    static long count = 0;
    double moved[SIZE];
    while (*t < end) {
        int is_finite = *t + *step != *t && ++count <= 10000000;
        for (int i = 0; i < SIZE; i++)
            is_finite = is_finite && isfinite(stages[0][i]);
        if (!is_finite)
            return 0;
        const double h = fmin(*step, end - *t);
        for (int k = 1; k < 7; k++) {
            for (int i = 0; i < SIZE; i++) {
                double sum = 0;
                for (int j = 0; j < k; j++)
                    sum += weights[k][j] * stages[j][i];
                moved[i] = x[i] + h * sum;
            }
            rates(*t + nodes[k] * h, moved, stages[k]);
        }
        double size = 0;
        for (int i = 0; i < SIZE; i++) {
            double sum = 0;
            for (int k = 0; k < 7; k++)
                sum += errors[k] * stages[k][i];
            const double its = fabs(h * sum / (least[i] + tolerance * fmax(fabs(x[i]), fabs(moved[i]))));
            size = its <= size ? size : its; // also if it is NaN
        }
        if (!(size <= 1)) {
            *step = isfinite(size) ? h * fmax(0.2, 0.9 * pow(size, -0.2)) : 0.2 * h;
            continue;
        }
        *t = h == end - *t ? end : *t + h;
        for (int i = 0; i < SIZE; i++) {
            x[i] = moved[i];
            stages[0][i] = stages[6][i];
        }
        const double grown = h * fmin(5, 0.9 * pow(fmax(size, 1e-10), -0.2));
        *step = h < *step ? fmax(*step, grown) : grown;
    }
    return 1;
}

static void print_row(double t, const double x[SIZE])
{
    printf("%.17g", t);
    for (int i = 0; i < SIZE; i++)
        printf(",%.17g", x[i]);
    printf("\\n");
}

int main(int count, char **words)
{
    const double until = count > 1 ? strtod(words[1], NULL) : end_time;
    const long steps = count > 2 ? strtol(words[2], NULL, 10) : step_count;
    double x[SIZE], stages[7][SIZE], least[SIZE], t = begin_time;
    rates(t, start, stages[0]);
    for (int i = 0; i < SIZE; i++) {
        x[i] = start[i];
        least[i] = tolerance * (x[i] == 0 ? sizes[i] : fmin(fabs(x[i]), sizes[i]));
    }
    double step = 1e-4 * (until - t);
    printf("$header\\n");
    print_row(t, x);
    for (long k = 1; k <= steps; k++) {
        const double end = k == steps ? until : begin_time + (until - begin_time) / steps * k;
        if (!advance(&t, end, x, stages, &step, least)) {
            fprintf(stderr, "the solution cannot be continued after time %.17g\\n", t);
            return 1;
        }
        print_row(t, x);
    }
    return 0;
}
""",
)


_JULIA_WORDS: Final = (
    "abstract baremodule begin break catch const continue do else elseif end export false finally for function "
    "global if import in isa let local macro module mutable new nothing outer primitive quote return struct true "
    "try tuple type undef using where while ans missing pi im Inf NaN sin cos tan cot exp log sqrt abs tanh t D W "
    "time along value model equations problem solution system Base Core Main row table until range solve println "
    "print zip e ModelingToolkit OrdinaryDiffEq StochasticDiffEq t_nounits D_nounits parameters variables brownians "
    "named register_symbolic System mtkcompile ODEProblem SDEProblem Vern9 EM abstol reltol saveat dt length eachindex "
    "as join Real clamp searchsortedlast view println Dict string state tolerances least unknowns"
)

JULIA: Final = Language(
    name="Julia",
    notation=Notation(cotangent="cot"),
    naming=Naming(frozenset(_JULIA_WORDS.split()), ("table_", "along_")),
    time="t",
    comment="#",
    remark="  # {}",
    where_undefined="a rate is not finite or an error is raised, and the solver ends with a return code",
    has_noise=True,
    usage="""\
$if process:Needs the packages ModelingToolkit (10 or later) and StochasticDiffEq.
$unless process:
$if states:Needs the packages ModelingToolkit (10 or later) and OrdinaryDiffEq.
$end
""",
    regression="""\
# $target
function value(<<inputs|$name>>)
$for constants:    $name = $value$remark
    return $formula
end
""",
    motion="""\
$if process:using ModelingToolkit, StochasticDiffEq
$unless process:using ModelingToolkit, OrdinaryDiffEq
using ModelingToolkit: t_nounits as t, D_nounits as D

$for constants:@parameters $name = $value$remark
$for held:@parameters $name = $value  # input, $about
$if tables:

# An input at a time: cubic between the times of its table, constant before and after.
function along(table, until, time)
    time = clamp(time, table[1, 1], until)
    row = searchsortedlast(view(table, :, 1), time)
    s = time - table[row, 1]
    return table[row, 2] + s*(table[row, 3] + s*(table[row, 4] + s*table[row, 5]))
end
$for tables:

# $about
const table_$name = [
$for cubics:    $since $c0 $c1 $c2 $c3
]
along_$name(time::Real) = along(table_$name, $until, time)
@register_symbolic along_$name(time)
$name = along_$name(t)
$end

$end
$for states:@variables $name(t) = $start  # $about
$if process:

@brownians <<states|$normal| >>
$for noise:$name = $expression
$end

equations = [
$for states,:    D($name) ~ $rate<<terms| + $root*$factor|>>
]
$for observed:@variables $name(t)  # $about
$for observed:push!(equations, $name ~ $value)
@named system = System(equations, t)
model = mtkcompile(system)

$if process:
problem = SDEProblem(model, [], ($first_time, $last_time))
solution = solve(problem, EM(); dt = $substep, saveat = range($first_time, $last_time; length = $rows))
$end
$unless process:
tolerances = Dict(<<states|string($name) => $least>>)
least = [tolerances[string(state)] for state in unknowns(model)]  # in the order of the compiled system
problem = ODEProblem(model, [], ($first_time, $last_time))
solution = solve(problem, Vern9(); abstol = least, reltol = 1e-12, \
saveat = range($first_time, $last_time; length = $rows))
$end

println("$header")
for row in eachindex(solution.t)
    println(join((solution.t[row], <<states|solution[$name][row]>>), ","))
end
""",
)


_MATLAB_WORDS: Final = (
    "break case catch classdef continue else elseif end for function global if otherwise parfor persistent return "
    "spmd switch try while do until endif endfor endfunction endwhile unwind_protect end_try_catch properties "
    "methods events enumeration arguments ans pi eps inf Inf nan NaN i j e nargin nargout varargin varargout true "
    "false sin cos tan cot exp reallog realsqrt realpow abs tanh atoll_model last rates along t state rate "
    "options observe column table times ppval mkpp linspace ode45 odeset fprintf numel min max value isempty clear"
)

MATLAB: Final = Language(
    name="MATLAB",
    notation=Notation(  # log, sqrt and powers would return complex numbers; these functions raise an error
        {LOG: "reallog", SQRT: "realsqrt"}, power="realpow({0}, {1})", natural="{0}^{1}", is_call=True, cotangent="cot"
    ),
    naming=Naming(frozenset(_MATLAB_WORDS.split()), ("along_",), longest=63),
    time="t",
    comment="%",
    remark=" % {}",
    where_undefined="ode45 ends early, or raises an error if a number would be complex",
    usage="Save as atoll_model.m. [t, x] = atoll_model(last) solves by ode45, one column of x for each state; "
    "without results it prints CSV. For a stiff model, replace ode45 by ode15s.",
    regression="""\
function value = atoll_model(<<inputs|$name>>)
$for constants:    $name = $value;$remark
    value = $formula;
end
""",
    motion="""\
function [t, x] = atoll_model(last)
    if nargin < 1, last = $last_time; end
    times = linspace($first_time, last, $rows);
    options = odeset('RelTol', 1e-12, 'AbsTol', [<<states|$least>>]);
    [t, x] = ode45(@rates, times, [<<states|$start>>], options);
    if nargout == 0
        fprintf('$header\\n');
        fprintf('%.17g<<states|,%.17g|>>\\n', [t, x].');
        clear t x
    end
end

function rate = rates(t, state)
$for states:    $name = state($number); % $about
$for constants:    $name = $value;$remark
$for held:    $name = $value; % input
$for tables:    $name = along_$name(t);
    rate = [
$for states:        $rate;
    ];
end
$if observed:

function column = observe(t, state)  % the measured columns that are computed from a state at time t
$for states:    $name = state($number); % $about
$for constants:    $name = $value;$remark
$for held:    $name = $value; % input
$for tables:    $name = along_$name(t);
    column = [
$for observed:        $value; % $about
    ];
end
$end
$for tables:

function value = along_$name(t)  % cubic between the times of a table, constant before and after
    persistent table
    if isempty(table)
        table = mkpp([<<cubics|$since>>, $until], [
$for cubics:        $c3, $c2, $c1, $c0;
        ]);
    end
    value = ppval(table, min(max(t, $since), $until));
end
$end
""",
)


_MODELICA_WORDS: Final = (
    "algorithm and annotation assert block break class connect connector constant constrainedby der discrete each "
    "else elseif elsewhen encapsulated end enumeration equation expandable extends external false final flow for "
    "function if import impure in initial inner input loop model not operator or outer output package parameter "
    "partial protected public pure record redeclare replaceable return stream then true type when while within "
    "time Real Integer Boolean String abs sign sqrt div mod rem ceil floor integer sin cos tan asin acos atan "
    "sinh cosh tanh exp log log10 pre edge change reinit sample smooth noEvent semiLinear delay cardinality "
    "homotopy terminate AtollModel along table start fixed annotation experiment nominal"
)

MODELICA: Final = Language(
    name="Modelica",
    notation=Notation(),
    naming=Naming(frozenset(_MODELICA_WORDS.split()), ("along_",)),
    time="time",
    comment="//",
    remark=' "{}"',
    where_undefined="the tool ends the simulation",
    motion="""\
model AtollModel
$for tables:
  function along_$name "cubic between the times of a table, constant before and after"
    input Real t;
    output Real value;
  protected
    constant Real table[$cubics, 5] = [
$for cubics;:      $since, $c0, $c1, $c2, $c3
    ];
    Real s;
    Integer row;
  algorithm
    row := 1;
    s := min(max(t, $since), $until);
    while row < $cubics and table[min(row + 1, $cubics), 1] <= s loop
      row := row + 1;
    end while;
    s := s - table[row, 1];
    value := table[row, 2] + s*(table[row, 3] + s*(table[row, 4] + s*table[row, 5]));
  end along_$name;
$end
$for constants:  parameter Real $name = $value$remark;
$for held:  parameter Real $name = $value "input, $about";
$for tables:  Real $name "input, $about";
$for states:  Real $name(start = $start, fixed = true, nominal = $nominal) "$about";
$for observed:  Real $name "$about";
equation
$for tables:  $name = along_$name(time);
$for states:  der($name) = $rate;
$for observed:  $name = $value;
  annotation(experiment(StartTime = $first_time, StopTime = $last_time, Interval = $step, Tolerance = 1e-12));
end AtollModel;
""",
)


_XPPAUT_WORDS: Final = (
    "sin cos tan atan atan2 sinh cosh tanh exp ln log log10 delay asin acos heav sign ceil flr ran abs max min "
    "normal besselj bessely besseli erf erfc arg poisson lgamma hom_bcs sqrt mod not if then else sum of shift "
    "del_shft int t pi i j e par param number init table wiener markov global aux bndry bdry done set volterra "
    "option options special solve only export vector block order x0 arg1 arg2 arg3 arg4 arg5 arg6 arg7 arg8 arg9 "
    "ishift isdel rate arg10 arg11 arg12 arg13 arg14 arg15 arg16 arg17 arg18 arg19 arg20 mouse_x mouse_y mouse_vx "
    "mouse_vy nxxqq"
)

XPPAUT: Final = Language(
    name="XPPAUT",
    notation=Notation({LOG: "ln"}),
    naming=Naming(frozenset(_XPPAUT_WORDS.split()), longest=9, is_caseless=True),
    time="t",
    comment="#",
    where_undefined="it ends the integration",
    has_noise=True,
    has_tables=False,
    longest=900,  # XPPAUT reads 1024
    usage="Open with: xppaut model.ode. AUTO (File, Auto) continues fixed points and cycles. XPPAUT keeps seven digits "
    "of its results.",
    motion="""\
$for constants:par $name=$value
$for held:par $name=$value
$for states:init $name=$start
$if process:
$for states:wiener $normal
$for noise:$name=$expression
$end
$for states:$name'=$rate<<terms| + $root*$factor|>>
$for observed:aux $name=$value
$if process:@ t0=$first_time, total=$duration, dt=$substep, njmp=100, meth=euler
$unless process:@ t0=$first_time, total=$duration, dt=$step, meth=83dp, tol=1e-12, atol=$least
@ maxstor=$reserved_rows, bounds=1e10
done
""",
)
