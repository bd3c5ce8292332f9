"""C99: a program that integrates by itself and prints CSV; of a regression a function."""

from typing import Final

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
static const double tolerance = 1e-12; // relative error of a step, about

// Go from time *t to time end with steps of about *step, stages[0] being the rates there; 0 where that is not possible.
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
            size = its <= size ? size : its; // also where it is not a number
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
            fprintf(stderr, "the solution does not go on beyond time %.17g\\n", t);
            return 1;
        }
        print_row(t, x);
    }
    return 0;
}
""",
)
