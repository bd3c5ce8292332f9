"""C99: a program that integrates by itself and prints CSV; of a regression a function."""

from typing import Final

from atoll.export import integrators
from atoll.export.language import Language
from atoll.export.naming import Naming
from atoll_core.expression.operators import ABS
from atoll_core.expression.text.infix import Notation

_WORDS: Final = (
    "auto break case char const continue default do double else enum extern float for goto if inline int long "
    "register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while "
    "bool true false asm typeof nullptr constexpr main errno stdin stdout stderr NULL EOF INFINITY NAN HUGE_VAL "
    "isnan isfinite sin cos tan exp log sqrt fabs tanh pow fmin fmax exit printf fprintf strtod strtol t state rate "
    "rates simulate along parameters value SIZE sizes"
)
_MACROS: Final = (
    "BIG_ENDIAN BUFSIZ BYTE_ORDER EXIT_FAILURE EXIT_SUCCESS FD_SETSIZE FILENAME_MAX FOPEN_MAX FP_ILOGB0 FP_ILOGBNAN "
    "FP_INFINITE FP_NAN FP_NORMAL FP_SUBNORMAL FP_ZERO HUGE HUGE_VALF HUGE_VALL LITTLE_ENDIAN L_ctermid L_cuserid "
    "L_tmpnam MATH_ERREXCEPT MATH_ERRNO MAXFLOAT MB_CUR_MAX M_1_PI M_2_PI M_2_SQRTPI M_E M_LN10 M_LN2 M_LOG10E "
    "M_LOG2E M_PI M_PI_2 M_PI_4 M_SQRT1_2 M_SQRT2 NFDBITS PDP_ENDIAN P_tmpdir RAND_MAX SEEK_CUR SEEK_END SEEK_SET "
    "TMP_MAX WCONTINUED WEXITED WNOHANG WNOWAIT WSTOPPED WUNTRACED math_errhandling linux unix DOMAIN OVERFLOW PLOSS "
    "SING TLOSS UNDERFLOW X_TLOSS"
)
"""Of the headers that the program includes, in the usual dialects: a column called so would be something else."""

LANGUAGE: Final = Language(
    name="C",
    notation=Notation({ABS: "fabs"}, power="pow({0}, {1})", natural="pow({0}, {1})", is_call=True),
    naming=Naming(frozenset([*_WORDS.split(), *_MACROS.split()]), ("table_",)),
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
// beside these errors are small: how large the states are, as far as they come back from it
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

// An input at time t: cubic between the times of its table, constant beyond.
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
"""
    + integrators.C,
)
