"""Our own elementary functions: accurate, the same bits everywhere, vectorised."""

import json
import os
import platform
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from atoll_core.expression.operators import TRIGONOMETRIC_LIMIT
from tests.oracles.elementary import (
    LOOPS,
    Floats,
    bit_patterns,
    digest_points,
    errors_in_ulp,
    near_quarter_turns,
    values,
)

ROOT = Path(__file__).resolve().parents[5]
NAN, INF = float("nan"), float("inf")
COUNT = 1500


def uniform(low: float, high: float, count: int = COUNT) -> Floats:
    return np.random.default_rng(7).uniform(low, high, count)


def powers_of_ten(low: float, high: float, count: int = COUNT) -> Floats:
    return 10.0 ** uniform(low, high, count)


def both_signs(x: Floats) -> Floats:
    return np.concatenate([x, -x])


def neighbours(x: float, count: int = 40) -> Floats:
    """Return the `count` doubles below x > 0, x, and the `count` - 1 doubles above it."""
    return (np.arange(-count, count) + np.float64(x).view(np.int64)).view(np.float64)


TRIGONOMETRIC_POINTS = {
    "around zero": uniform(-1.0, 1.0),
    "a few turns": uniform(-20.0, 20.0),
    "the whole range": uniform(-1e5, 1e5),
    "the upper end": neighbours(1e5)[:41],
    "multiples of pi/2": both_signs(near_quarter_turns(700)),
    "tiny": both_signs(powers_of_ten(-320, -1)),
    "where the quadrant changes": both_signs(np.concatenate([neighbours(k * np.pi / 4) for k in (1, 3, 5, 7, 20001)])),
}
POINTS = {
    "sin": TRIGONOMETRIC_POINTS,
    "cos": TRIGONOMETRIC_POINTS,
    "exp": {
        "around zero": uniform(-1.0, 1.0),
        "normal results": uniform(-708.0, 709.7),
        "subnormal results": uniform(-745.5, -708.0),
        "where it overflows": neighbours(709.782712893384),
        "where it becomes subnormal": -neighbours(708.3964185322641),
        "where it vanishes": -neighbours(745.1332191019411),
        "tiny": both_signs(powers_of_ten(-320, -1)),
    },
    "log": {
        "around one": uniform(0.5, 2.0),
        "next to one": neighbours(1.0),
        "where the exponent changes": np.concatenate([neighbours(0.5**0.5), neighbours(2.0**0.5)]),
        "all exponents": np.abs(bit_patterns(COUNT, 3)[np.isfinite(bit_patterns(COUNT, 3))]),
        "subnormals": np.concatenate([powers_of_ten(-323, -308), [5e-324, 2.2250738585072014e-308]]),
        "the largest": neighbours(1.7976931348623157e308)[:41],
    },
    "tanh": {
        "around zero": uniform(-1.0, 1.0),
        "until it saturates": uniform(-25.0, 25.0),
        "tiny": both_signs(powers_of_ten(-320, -1)),
        "huge": both_signs(powers_of_ten(1, 308)),
    },
}
LARGEST_ERROR_IN_ULP = {"sin": 2.0, "cos": 2.0, "exp": 2.0, "log": 2.0, "tanh": 3.0}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "region"), [(name, region) for name in POINTS for region in POINTS[name]])
def test_values_are_within_a_few_units_of_the_last_place(name: str, region: str) -> None:
    assert errors_in_ulp(name, POINTS[name][region]).max() <= LARGEST_ERROR_IN_ULP[name]


POWER_POINTS = {
    "moderate": (powers_of_ten(-2, 2), uniform(-4.0, 4.0)[::-1]),
    "next to one": (1.0 + uniform(-1e-6, 1e-6), uniform(-5e8, 5e8)[::-1]),
    "all results": (powers_of_ten(-5, 5), uniform(-60.0, 60.0)[::-1]),
    "subnormal bases": (powers_of_ten(-323, -308), uniform(-0.9, 0.9)[::-1]),
    "subnormal results": (powers_of_ten(1, 2), -310.0 / np.log10(powers_of_ten(1, 2))),
    "whole exponents": (both_signs(uniform(0.1, 10.0)), np.floor(uniform(-9.0, 9.0, 2 * COUNT))[::-1]),
}


@pytest.mark.parametrize("region", POWER_POINTS)
def test_powers_are_within_two_units_of_the_last_place(region: str) -> None:
    assert errors_in_ulp("pow", *POWER_POINTS[region]).max() <= 2.0


def assert_same(name: str, cases: list[tuple[float, ...]]) -> None:
    """Compare values with cases (arguments..., expected); the sign of a zero counts."""
    columns = list(zip(*cases, strict=True))
    np.testing.assert_array_equal(values(name, *columns[:-1]), columns[-1])
    known = ~np.isnan(columns[-1])
    np.testing.assert_array_equal(np.signbit(values(name, *columns[:-1]))[known], np.signbit(columns[-1])[known])


@pytest.mark.parametrize("name", ["sin", "cos"])
def test_turns_beyond_the_limit_are_not_a_number(name: str) -> None:
    beyond = np.nextafter(TRIGONOMETRIC_LIMIT, INF)
    assert_same(name, [(x, NAN) for x in (beyond, -beyond, 1e300, INF, -INF, NAN)])
    assert np.isfinite(values(name, [TRIGONOMETRIC_LIMIT, -TRIGONOMETRIC_LIMIT])).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sin", "cos"])
def test_sine_and_cosine_never_exceed_one(name: str) -> None:
    extremes = both_signs(near_quarter_turns(63660))
    assert np.abs(values(name, np.concatenate([extremes, uniform(-4.0, 4.0, 100_000)]))).max() == 1.0


def test_simple_values_are_exact() -> None:
    assert_same("cos", [(0.0, 1.0), (-0.0, 1.0), (1e-9, 1.0)])
    assert_same("sin", [(0.0, 0.0), (5e-324, 5e-324), (-1e-300, -1e-300)])
    assert_same("exp", [(0.0, 1.0), (-0.0, 1.0), (INF, INF), (-INF, 0.0), (NAN, NAN), (1e308, INF), (-1e308, 0.0)])
    assert_same("log", [(1.0, 0.0), (0.0, -INF), (-0.0, -INF), (-1e-320, NAN), (-INF, NAN), (INF, INF), (NAN, NAN)])
    assert_same("tanh", [(0.0, 0.0), (-0.0, -0.0), (INF, 1.0), (-INF, -1.0), (NAN, NAN), (5e-324, 5e-324)])


def test_sine_is_odd_and_cosine_even() -> None:
    x = digest_points(20_000, 5)
    np.testing.assert_array_equal(values("sin", -x), -values("sin", x))
    np.testing.assert_array_equal(values("cos", -x), values("cos", x))


def test_power_is_defined_where_the_operator_table_says() -> None:
    assert_same(
        "pow",
        [
            *[(0.0, 2.5, 0.0), (-0.0, 3.0, 0.0), (0.0, INF, 0.0)],
            *[(0.0, -1.0, NAN), (-0.0, -2.0, NAN), (0.0, -INF, NAN), (-2.0, 0.5, NAN), (-1e-300, 1e-300, NAN)],
            *[(-2.0, 3.0, -8.0), (-2.0, 2.0, 4.0), (-2.0, -1.0, -0.5), (-1.0, 2.0**53 - 1.0, -1.0)],
            *[(-1.0, 2.0**52 + 1.0, -1.0), (-1.0, 2.0**51 + 0.5, NAN), (-1.0, 2.0**53, 1.0), (-1.0, 1e300, 1.0)],
            *[(2.0, 1024.0, INF), (-2.0, 1025.0, -INF), (2.0, -1074.0, 5e-324), (2.0, -1080.0, 0.0), (2.0, 1e308, INF)],
            *[(4.0, 0.5, 2.0), (10.0, 2.0, 100.0), (1.0, 1e308, 1.0), (0.5, 1e300, 0.0)],
        ],
    )


def test_anything_to_the_power_of_zero_is_one_but_not_a_number_stays() -> None:
    cases = [(x, zero, 1.0) for x in (0.0, -0.0, -2.5, 3.0, INF, -INF, 5e-324) for zero in (0.0, -0.0)]
    assert_same("pow", [*cases, (NAN, 0.0, NAN), (0.0, NAN, NAN), (2.0, NAN, NAN), (NAN, 2.0, NAN)])


def test_powers_of_infinity_follow_the_limit() -> None:
    assert_same(
        "pow",
        [
            *[(INF, 0.5, INF), (INF, -0.5, 0.0), (-INF, 3.0, -INF), (-INF, 2.0, INF), (-INF, 0.5, NAN)],
            *[(2.0, INF, INF), (2.0, -INF, 0.0), (0.5, INF, 0.0), (0.5, -INF, INF)],
            *[(1.0, INF, 1.0), (1.0, -INF, 1.0), (-1.0, INF, 1.0), (0.0, INF, 0.0), (-0.5, INF, 0.0)],
        ],
    )


@pytest.mark.parametrize("name", ["sin", "cos", "exp", "log", "tanh"])
def test_packed_and_single_rows_give_the_same_bits(name: str) -> None:
    """A loop computes most rows in vectors with their neighbours, and the last rows alone."""
    x = digest_points(400, 11)
    alone = np.array([values(name, [point])[0] for point in x])
    np.testing.assert_array_equal(values(name, x), alone)


def report(cache: Path, count: int, **environment: str) -> dict[str, dict[str, Any]]:
    """Run the digest program in a new process with the kernel cache `cache`; return its output by function."""
    inherited = {key: value for key, value in os.environ.items() if not key.startswith(("NUMBA_", "ATOLL_"))}
    command = [sys.executable, "-m", "tests.oracles.elementary", str(count)]
    settings = inherited | {"ATOLL_KERNEL_CACHE": str(cache)} | environment
    finished = subprocess.run(command, cwd=ROOT, env=settings, capture_output=True, text=True, check=True)
    written: dict[str, dict[str, Any]] = json.loads(finished.stdout)
    return written


def digests(digests_found: dict[str, dict[str, Any]]) -> dict[str, str]:
    return {name: entry["digest"] for name, entry in digests_found.items()}


@pytest.fixture(scope="module")
def native(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    return report(tmp_path_factory.mktemp("native"), 100_000)


@pytest.mark.slow
def test_a_generic_processor_gives_the_same_bits(native: dict[str, dict[str, Any]], tmp_path: Path) -> None:
    assert digests(report(tmp_path, 100_000, NUMBA_CPU_NAME="generic")) == digests(native)


@pytest.mark.slow
def test_the_interpreter_gives_the_same_bits_as_the_compiler(tmp_path: Path) -> None:
    compiled, interpreted = report(tmp_path, 2000), report(tmp_path, 2000, NUMBA_DISABLE_JIT="1")
    assert digests(interpreted) == digests(compiled)


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="counts x86-64 instructions")
@pytest.mark.parametrize("name", LOOPS)
def test_loops_are_packed_and_never_fused(native: dict[str, dict[str, Any]], name: str) -> None:
    """The loop over the remaining rows, unrolled or not, has a scalar copy of each packed multiplication."""
    packed, scalar, fused = native[name]["code"]
    assert packed > 0
    assert scalar > 0
    assert scalar % packed == 0
    assert fused == 0
