"""Exact values of the elementary functions (mpmath), errors in ulp, and loops over our own functions to measure.

Run as a program (``python -m tests.oracles.elementary COUNT``) it prints, as JSON, a digest of the bits of every
function over COUNT points and the packed and scalar multiplications of its loop, as compiled for the processor that
the environment chooses.
"""

import hashlib
import json
import re
import sys
from collections.abc import Callable, Sequence
from typing import Any

import mpmath
import numpy as np
import numpy.typing as npt

from atoll_core.compilation.jit import kernel
from atoll_core.expression.kernels.elementary import (
    strict_cos,
    strict_exp,
    strict_log,
    strict_pow,
    strict_sin,
    strict_tanh,
)

Floats = npt.NDArray[np.float64]
SMALLEST_SUBNORMAL = 5e-324


@kernel
def sin_into(out: Floats, x: Floats) -> None:
    """Write sin(x) into out."""
    for row in range(x.shape[0]):
        out[row] = strict_sin(x[row])


@kernel
def cos_into(out: Floats, x: Floats) -> None:
    """Write cos(x) into out."""
    for row in range(x.shape[0]):
        out[row] = strict_cos(x[row])


@kernel
def exp_into(out: Floats, x: Floats) -> None:
    """Write exp(x) into out."""
    for row in range(x.shape[0]):
        out[row] = strict_exp(x[row])


@kernel
def log_into(out: Floats, x: Floats) -> None:
    """Write log(x) into out."""
    for row in range(x.shape[0]):
        out[row] = strict_log(x[row])


@kernel
def tanh_into(out: Floats, x: Floats) -> None:
    """Write tanh(x) into out."""
    for row in range(x.shape[0]):
        out[row] = strict_tanh(x[row])


@kernel
def pow_into(out: Floats, x: Floats, y: Floats) -> None:
    """Write x**y into out."""
    for row in range(x.shape[0]):
        out[row] = strict_pow(x[row], y[row])


LOOPS: dict[str, Callable[..., None]] = {
    "sin": sin_into,
    "cos": cos_into,
    "exp": exp_into,
    "log": log_into,
    "tanh": tanh_into,
    "pow": pow_into,
}
EXACT: dict[str, Callable[..., Any]] = {
    "sin": mpmath.sin,
    "cos": mpmath.cos,
    "exp": mpmath.exp,
    "log": mpmath.log,
    "tanh": mpmath.tanh,
    "pow": mpmath.power,
}


def values(name: str, *arguments: Sequence[float] | Floats) -> Floats:
    """Return what our function `name` gives at the arguments, by a compiled loop."""
    columns = [np.array(column, dtype=np.float64) for column in arguments]
    out = np.empty_like(columns[0])
    LOOPS[name](out, *columns)
    return out


def errors_in_ulp(name: str, *arguments: Floats) -> Floats:
    """Return the distance of our values from the exact ones, in units of the last place of the exact one.

    Infinite where exactly one of the two overflows. The arguments lie where the function is real.
    """
    ours = values(name, *arguments)
    with mpmath.workprec(140):
        rows = zip(ours, *arguments, strict=True)
        return np.array([_error_in_ulp(value, EXACT[name](*map(_exactly, point))) for value, *point in rows])


def _exactly(x: float) -> Any:
    return mpmath.mpf(float(x))


def _error_in_ulp(value: float, exact: Any) -> float:
    nearest = float(exact)
    if not np.isfinite(nearest) or not np.isfinite(value):
        return 0.0 if nearest == value else float("inf")
    unit = np.spacing(abs(nearest)) if nearest else SMALLEST_SUBNORMAL
    return float(abs(_exactly(value) - exact) / _exactly(unit))


def near_quarter_turns(count: int) -> Floats:
    """Return the doubles around `count` multiples of pi/2 between 0 and 1e5, of every residue modulo 4."""
    quarters = np.unique(np.linspace(1, 63660, count).astype(np.int64))
    with mpmath.workprec(140):
        nearest = np.array([float(mpmath.pi / 2 * int(quarter)) for quarter in quarters])
    return np.concatenate([np.nextafter(nearest, 0.0), nearest, np.nextafter(nearest, np.inf)])


def bit_patterns(count: int, seed: int) -> Floats:
    """Return random bit patterns as doubles: every exponent, both signs, subnormals, a few NaN."""
    return np.random.default_rng(seed).integers(-(2**63), 2**63 - 1, count, endpoint=True).view(np.float64)


def digest_points(count: int, seed: int) -> Floats:
    """Return points for a digest: a quarter each over all doubles, |x| <= 1e5, |x| <= 30, and whole numbers."""
    random = np.random.default_rng(seed)
    part = count // 4
    wide, near = random.uniform(-1e5, 1e5, part), random.uniform(-30.0, 30.0, part)
    return np.concatenate([bit_patterns(part, seed), wide, near, random.integers(-40, 40, part).astype(np.float64)])


def digest_of_bits(name: str, count: int) -> str:
    """Return a digest of the bits of our function at `count` points, all NaN taken as equal."""
    x = digest_points(count, 1)
    out = values(name, x, np.random.default_rng(2).permutation(x)) if name == "pow" else values(name, x)
    out[np.isnan(out)] = np.nan
    return hashlib.blake2b(out.tobytes(), digest_size=16).hexdigest()


def multiplications(name: str) -> tuple[int, int, int]:
    """Return the packed, scalar and fused multiplications in the machine code of a loop; zeros with the JIT off."""
    inspect = getattr(LOOPS[name], "inspect_asm", dict)
    code = "\n".join(inspect().values())
    kinds = (r"\bv?mulpd\b", r"\bv?mulsd\b", r"\bvf\w+[sp]d\b")
    packed, scalar, fused = (len(re.findall(kind, code)) for kind in kinds)
    return packed, scalar, fused


def main() -> None:
    """Print digests and multiplications of all functions."""
    count = int(sys.argv[1])
    with np.errstate(all="ignore"):
        report = {name: {"digest": digest_of_bits(name, count), "code": multiplications(name)} for name in LOOPS}
    json.dump(report, sys.stdout)


if __name__ == "__main__":
    main()
