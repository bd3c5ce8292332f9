"""Accuracy and speed of the strict elementary functions: ``python -m benchmarks.kernels.elementary [POINTS]``.

Accuracy: largest and mean error against mpmath, in units of the last place. Speed: millions of values per second on one
core, in loops over 16 rows (as in a fitness predictor) and over 4096 rows. For comparison, the program also times a
single multiply-add and a polynomial of 44 operations; sin has about as many operations.
"""

import sys
import time
from collections.abc import Callable

import numpy as np

from atoll_core.compilation.jit import inlined, kernel
from tests.oracles.elementary import LOOPS, Floats, bit_patterns, errors_in_ulp, near_quarter_turns

REPETITIONS = 7
VALUES_PER_REPETITION = 400_000


@inlined
def _four_steps(value: float, x: float) -> float:
    """Return `value` after four multiplications by x and four additions."""
    return (((value * x + 0.1) * x + 0.2) * x + 0.3) * x + 0.4


@kernel
def multiply_add_into(out: Floats, x: Floats) -> None:
    """Write x * 0.5 + 0.25 into `out`; both are (R,)."""
    for row in range(x.shape[0]):
        out[row] = x[row] * 0.5 + 0.25


@kernel
def polynomial_into(out: Floats, x: Floats) -> None:
    """Write the sum of three polynomials into `out` (R,): 44 operations in two long chains and a short one."""
    for row in range(x.shape[0]):
        r = x[row]
        first = _four_steps(_four_steps(r, r), r)
        second = _four_steps(_four_steps(0.5, r), r)
        out[row] = (first * r + 0.6) * r + (second * r + 0.7) * r + ((r * 0.8 + 0.9) * r + 1.0)


def ranges(points: int) -> dict[str, dict[str, tuple[Floats, ...]]]:
    """Return named sets of `points` arguments for each function; for pow each set has x and y."""

    def uniform(low: float, high: float) -> Floats:
        return np.random.default_rng(3).uniform(low, high, points)

    def powers_of_ten(low: float, high: float) -> Floats:
        return 10.0 ** uniform(low, high)

    patterns = bit_patterns(points, 4)
    turns: dict[str, tuple[Floats, ...]] = {
        "|x| <= 1": (uniform(-1.0, 1.0),),
        "|x| <= 1e5": (uniform(-1e5, 1e5),),
        "next to n pi/2, |x| <= 1e5": (near_quarter_turns(points // 3),),
        "1e-320 ... 0.1": (powers_of_ten(-320, -1),),
    }
    shuffled = np.random.default_rng(5).permutation
    return {
        "sin": turns,
        "cos": turns,
        "exp": {
            "|x| <= 1": (uniform(-1.0, 1.0),),
            "-708 ... 709": (uniform(-708.0, 709.0),),
            "subnormal results": (uniform(-745.0, -708.0),),
        },
        "log": {
            "0.5 ... 2": (uniform(0.5, 2.0),),
            "1 +- 1e-6": (1.0 + uniform(-1e-6, 1e-6),),
            "all positive": (np.abs(patterns[np.isfinite(patterns)]),),
        },
        "tanh": {"|x| <= 1": (uniform(-1.0, 1.0),), "|x| <= 25": (uniform(-25.0, 25.0),)},
        "pow": {
            "x 0.01 ... 100, |y| <= 4": (powers_of_ten(-2, 2), shuffled(uniform(-4.0, 4.0))),
            "x 1e-5 ... 1e5, |y| <= 60": (powers_of_ten(-5, 5), shuffled(uniform(-60.0, 60.0))),
            "x 1 +- 1e-6, |y| <= 5e8": (1.0 + uniform(-1e-6, 1e-6), shuffled(uniform(-5e8, 5e8))),
        },
    }


def repeated(loop: Callable[..., None]) -> Callable[..., None]:
    """Return a kernel that runs `loop` many times, so that the time of the call from Python is negligible."""

    @kernel
    def run(times: int, out: Floats, x: Floats) -> None:
        for _ in range(times):
            loop(out, x)

    @kernel
    def run_with_power(times: int, out: Floats, x: Floats) -> None:
        for _ in range(times):
            loop(out, x, x)

    return run_with_power if loop is LOOPS["pow"] else run


def millions_per_second(loop: Callable[..., None], rows: int) -> float:
    """Return the millions of values per second in the fastest repetition."""
    x = np.random.default_rng(6).uniform(0.1, 3.0, rows)
    out, run, times = np.empty(rows), repeated(loop), VALUES_PER_REPETITION // rows
    run(1, out, x)
    fastest = float("inf")
    for _ in range(REPETITIONS):
        start = time.perf_counter()
        run(times, out, x)
        fastest = min(fastest, time.perf_counter() - start)
    return times * rows / fastest / 1e6


def print_accuracy(points: int) -> None:
    """Print a line for each function and each set of arguments."""
    print(f"{'function':9}{'arguments':29}{'largest':>9}{'mean':>8}   (ulp, {points} points)")
    for name, sets in ranges(points).items():
        for region, arguments in sets.items():
            errors = errors_in_ulp(name, *arguments)
            print(f"{name:9}{region:29}{errors.max():9.3f}{errors.mean():8.3f}")


def print_speed() -> None:
    """Print a line for each loop."""
    print(f"\n{'loop':14}{'16 rows':>10}{'4096 rows':>11}   (million values per second, one core)")
    loops = {"multiply-add": multiply_add_into, "44 operations": polynomial_into} | LOOPS
    for name, loop in loops.items():
        print(f"{name:14}{millions_per_second(loop, 16):10.0f}{millions_per_second(loop, 4096):11.0f}")


def main() -> None:
    """Measure and print."""
    print_accuracy(int(sys.argv[1]) if len(sys.argv) > 1 else 10_000)
    print_speed()


if __name__ == "__main__":
    main()
