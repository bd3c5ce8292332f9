"""Ends of templates of files that integrate by themselves, since no program with an integrator opens them."""

from typing import Final

C: Final = """\

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
"""
PYTHON: Final = '''\
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
'''
