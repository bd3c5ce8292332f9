"""Implementations of sin, cos, exp, log, tanh and pow with the same bits on every processor. Loops over them vectorise.

They use only IEEE 754 double + - * /, comparisons, selections and integer operations on the bit pattern. There is no
fused multiply-add, no call of a mathematical library, no table and no branch, so that a simple loop in a `kernel` is
compiled to packed instructions. Largest measured errors, in ulp: sin 1.6, cos 1.4, exp 1.0, log 0.8, tanh 2.5, pow 1.1
(``benchmarks/kernels/elementary.py``, which also prints the speed).

Each function takes and returns a float64. With the JIT off, it takes a float and returns an ``np.float64``; overflow
then warns unless ``np.errstate`` silences it. Signs, zeros, infinities and NaN follow IEEE 754's recommended functions,
except sin and cos beyond `LIMIT` and the cases of pow that `strict_pow` names. The payload and the sign of a NaN are
arbitrary.

Polynomials are split into even and odd halves or into groups. In loops over 16 rows the time depends on the longest
chain of dependent operations, not on the number of operations.
"""

from typing import Final

import numpy as np

from atoll_core.compilation.jit import inlined
from atoll_core.expression.operators import TRIGONOMETRIC_LIMIT

LIMIT: Final = TRIGONOMETRIC_LIMIT
NAN: Final = float("nan")
INFINITY: Final = float("inf")

# Adding 1.5 * 2**52 rounds to the nearest integer. The low bits of the sum then hold this integer in two's complement.
ROUNDER: Final = 6755399441055744.0
SIGN_BIT: Final = -(2**63)
MAGNITUDE_BITS: Final = 2**63 - 1

TWO_OVER_PI: Final = 0.6366197723675814
# pi/2 in parts of 37, 37 and 53 bits: the product of n, |n| < 2**16, with each of the first two parts is exact.
HALF_PI_1: Final = 1.5707963267923333
HALF_PI_2: Final = 2.5633441515839558e-12
HALF_PI_3: Final = 1.0562999066987428e-23
# sin(r)/r = 1 + z S(z) and cos(r) = 1 - z/2 + z**2 C(z), z = r**2, |r| <= pi/4, to 2**-58: the coefficients
# published with fdlibm 5.3 (Sun Microsystems 1993), k_sin.c and k_cos.c.
S1: Final = -1.66666666666666324348e-01
S2: Final = 8.33333333332248946124e-03
S3: Final = -1.98412698298579493134e-04
S4: Final = 2.75573137070700676789e-06
S5: Final = -2.50507602534068634195e-08
S6: Final = 1.58969099521155010221e-10
C1: Final = 4.16666666666666019037e-02
C2: Final = -1.38888888888741095749e-03
C3: Final = 2.48015872894767294178e-05
C4: Final = -2.75573143513906633035e-07
C5: Final = 2.08757232129817482790e-09
C6: Final = -1.13596475577881948265e-11

ONE_OVER_LN2: Final = 1.4426950408889634
# ln 2 in parts of 40 and 53 bits: the product of n, |n| < 2**13, with the first part is exact.
LN2_1: Final = 0.6931471805592082
LN2_2: Final = 7.371002565167799e-13
EXP_OVERFLOW: Final = 710.0
EXP_UNDERFLOW: Final = -746.0
# `ROUNDER` + 2 * 1023: the low bits of the sum then hold n + 2046, which is positive for every n that occurs.
EXP_ROUNDER: Final = ROUNDER + 2046.0
# exp(r) = 1 + r + r**2 E(r), |r| <= ln(2)/2: minimax fit of this project (Remez exchange, relative error 2**-57.9).
E0: Final = 0.5000000000000011
E1: Final = 0.16666666666666413
E2: Final = 0.04166666666653027
E3: Final = 0.008333333333494336
E4: Final = 0.0013888888943596523
E5: Final = 0.00019841269506766767
E6: Final = 2.48014931373598e-05
E7: Final = 2.755758628092083e-06
E8: Final = 2.7630233526432066e-07
E9: Final = 2.5000067424047497e-08
TANH_SATURATION: Final = 22.0
TANH_ROUNDER: Final = ROUNDER + 1023.0

SMALLEST_NORMAL: Final = 2.2250738585072014e-308
TWO_54: Final = 18014398509481984.0
SQRT_HALF_BITS: Final = 0x3FE6A09E667F3BCD
ONE_BITS: Final = 0x3FF0000000000000
FRACTION_BITS: Final = 0x000FFFFFFFFFFFFF
TWO_52: Final = 4503599627370496.0
TWO_52_BITS: Final = 0x4330000000000000
# log(1 + f) = 2 s + s R(s**2), s = f/(2 + f), sqrt(1/2) <= 1 + f <= sqrt(2), R(z) = L1 z + L2 z**2 + ..., to 2**-58:
# the coefficients published with fdlibm 5.3, e_log.c.
L1: Final = 6.666666666666735130e-01
L2: Final = 3.999999999940941908e-01
L3: Final = 2.857142874366239149e-01
L4: Final = 2.222219843214978396e-01
L5: Final = 1.818357216161805012e-01
L6: Final = 1.531383769920937332e-01
L7: Final = 1.479819860511658591e-01
# log(1 + f) = 2 s + s (2/3 z + z**2 T(z)), z = s**2, for pow: minimax fit of this project (Remez exchange, error of
# z**2 T(z) 2**-65).
T0: Final = 0.40000000000002256
T1: Final = 0.2857142857010008
T2: Final = 0.22222222519821935
T3: Final = 0.18181784376745203
T4: Final = 0.1538675685585845
T5: Final = 0.1325682948532744
T6: Final = 0.13196214139636542
TWO_THIRDS_1: Final = 0.6666666666666666
TWO_THIRDS_2: Final = 3.700743415417188e-17
HUGE_POWER: Final = 1e300
"""Exponents are limited to this magnitude, because `_two_product` fails beyond 1e300. A power with a larger exponent is
infinity, 0 or 1 anyway."""
SPLITTER: Final = 134217729.0  # 2**27 + 1: splits a number into two halves of 26 bits


@inlined
def _bits(x: float) -> np.int64:
    """Return the bit pattern of a float64."""
    return np.float64(x).view(np.int64)


@inlined
def _from_bits(pattern: np.int64) -> float:
    """Return the float64 with the given bit pattern."""
    return np.int64(pattern).view(np.float64)


@inlined
def _quarter_turns(x: float) -> tuple[float, float, np.int64]:
    """Return r, its error and n with x = n pi/2 + r + error, |r| <= pi/4 (Cody and Waite 1980).

    Only the low bits of the returned n are meaningful.
    """
    shifted = x * TWO_OVER_PI + ROUNDER
    n = shifted - ROUNDER
    first = x - n * HALF_PI_1
    product = n * HALF_PI_2
    second = first - product
    rest = ((first - second) - product) - n * HALF_PI_3
    r = second + rest
    return r, (second - r) + rest, _bits(shifted)


@inlined
def _sine(r: float, error: float) -> float:
    """Return sin(r + error) for |r| <= pi/4."""
    z = r * r
    w = z * z
    series = (S1 + z * S2) + w * ((S3 + z * S4) + w * (S5 + z * S6))
    return r + ((r * z) * series + error)


@inlined
def _cosine(r: float) -> float:
    """Return cos(r) for |r| <= pi/4; the rounding error of r adds at most 0.4 ulp."""
    z = r * r
    w = z * z
    half = 0.5 * z
    series = (C1 + z * C2) + w * ((C3 + z * C4) + w * (C5 + z * C6))
    return (1.0 - half) + w * series


@inlined
def strict_sin(x: float) -> float:
    """Return sin(x); NaN for |x| > LIMIT and for x that is not finite. sin(-0.0) is 0.0."""
    r, error, turns = _quarter_turns(x)
    sine = _sine(r, error)
    cosine = _cosine(r)
    value = cosine if turns & 1 else sine
    value = _from_bits(_bits(value) ^ ((turns & 2) << 62))
    return value if abs(x) <= LIMIT else NAN


@inlined
def strict_cos(x: float) -> float:
    """Return cos(x); NaN for |x| > LIMIT and for x that is not finite."""
    r, error, turns = _quarter_turns(x)
    sine = _sine(r, error)
    cosine = _cosine(r)
    value = sine if turns & 1 else cosine
    value = _from_bits(_bits(value) ^ (((turns + 1) & 2) << 62))
    return value if abs(x) <= LIMIT else NAN


@inlined
def _exponential_minus_one(r: float) -> float:
    """Return exp(r) - 1 for |r| <= ln(2)/2."""
    z = r * r
    w = z * z
    low = (E0 + r * E1) + z * (E2 + r * E3)
    high = ((E4 + r * E5) + z * (E6 + r * E7)) + w * (E8 + r * E9)
    return r + z * (low + w * high)


@inlined
def _exponential(x: float, addend: float) -> float:
    """Return exp(x + addend), |addend| < 1e-6; scaled in two steps, for correct overflow and subnormal results."""
    clamped = EXP_OVERFLOW if x > EXP_OVERFLOW else x
    clamped = EXP_UNDERFLOW if clamped < EXP_UNDERFLOW else clamped
    shifted = clamped * ONE_OVER_LN2 + EXP_ROUNDER
    n = shifted - EXP_ROUNDER
    r = ((clamped - n * LN2_1) - n * LN2_2) + addend
    biased = _bits(shifted) & 0xFFF
    half = biased >> 1
    value = 1.0 + _exponential_minus_one(r)
    return (value * _from_bits(half << 52)) * _from_bits((biased - half) << 52)


@inlined
def strict_exp(x: float) -> float:
    """Return exp(x); infinity above 709.78, subnormal below -708.40, 0 below -745.13."""
    return _exponential(x, -0.0)


@inlined
def _binary_logarithm_split(x: float) -> tuple[float, float]:
    """Return integer n and f with x = 2**n (1 + f), sqrt(1/2) <= 1 + f < sqrt(2); x positive and finite."""
    is_subnormal = x < SMALLEST_NORMAL
    scaled = x * TWO_54 if is_subnormal else x
    pattern = _bits(scaled) + (ONE_BITS - SQRT_HALF_BITS)
    n = _from_bits(((pattern >> 52) & 0x7FF) | TWO_52_BITS) - (TWO_52 + 1023.0)
    fraction = _from_bits((pattern & FRACTION_BITS) + SQRT_HALF_BITS)
    return n - (54.0 if is_subnormal else 0.0), fraction - 1.0


@inlined
def _logarithm_series(z: float) -> float:
    """Return R(z), see `L1`."""
    w = z * z
    return z * (L1 + w * (L3 + w * (L5 + w * L7))) + w * (L2 + w * (L4 + w * L6))


@inlined
def strict_log(x: float) -> float:
    """Return log(x); -infinity at 0, NaN for negative x."""
    n, f = _binary_logarithm_split(x)
    s = f / (2.0 + f)
    half_square = (0.5 * f) * f
    correction = s * (half_square + _logarithm_series(s * s)) + n * LN2_2
    value = n * LN2_1 - ((half_square - correction) - f)
    value = value if x < INFINITY else x
    at_most_zero = -INFINITY if x == 0.0 else NAN
    return value if x > 0.0 else at_most_zero


@inlined
def strict_tanh(x: float) -> float:
    """Return tanh(x) = -e/(2 + e), e = exp(-2|x|) - 1, with the sign of x."""
    magnitude = abs(x)
    clamped = -2.0 * (TANH_SATURATION if magnitude > TANH_SATURATION else magnitude)
    shifted = clamped * ONE_OVER_LN2 + TANH_ROUNDER
    n = shifted - TANH_ROUNDER
    r = (clamped - n * LN2_1) - n * LN2_2
    scale = _from_bits((_bits(shifted) & 0xFFF) << 52)
    e = scale * _exponential_minus_one(r) + (scale - 1.0)
    value = -e / (2.0 + e)
    return _from_bits((_bits(value) & MAGNITUDE_BITS) | (_bits(x) & SIGN_BIT))


@inlined
def _two_product(a: float, b: float) -> tuple[float, float]:
    """Return the rounded product and its error (Dekker 1971); |a|, |b| < 1e300, no underflow."""
    product = a * b
    a_scaled = a * SPLITTER
    a_high = a_scaled - (a_scaled - a)
    a_low = a - a_high
    b_scaled = b * SPLITTER
    b_high = b_scaled - (b_scaled - b)
    b_low = b - b_high
    return product, ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


@inlined
def _logarithm_pair(x: float) -> tuple[float, float]:
    """Return log(x) as a pair of numbers whose sum is log(x), with relative error about 2**-63; x positive and finite.

    The series is 2 s + s**3 (2/3 + ...) with s = f/(2 + f), where s, s**2, 2/3 and the products are also pairs.
    """
    n, f = _binary_logarithm_split(x)
    d = 2.0 + f
    d_error = f - (d - 2.0)
    reciprocal = 1.0 / d
    s = f * reciprocal
    product, error = _two_product(s, d)
    s_error = (((f - product) - error) - s * d_error) * reciprocal
    z, z_error = _two_product(s, s)
    z_error = z_error + 2.0 * s * s_error
    w = z * z
    tail = z * (T0 + w * (T2 + w * (T4 + w * T6))) + w * (T1 + w * (T3 + w * T5))
    third = TWO_THIRDS_1 + tail
    third_error = ((TWO_THIRDS_1 - third) + tail) + TWO_THIRDS_2
    cubic, cubic_error = _two_product(z, third)
    cubic_error = cubic_error + (z * third_error + z_error * third)
    factor = 2.0 + cubic
    factor_error = ((2.0 - factor) + cubic) + cubic_error
    value, value_error = _two_product(s, factor)
    value_error = value_error + (s * factor_error + s_error * factor)
    whole = n * LN2_1
    high = whole + value
    low = ((whole - high) + value) + (n * LN2_2 + value_error)
    total = high + low
    return total, (high - total) + low


@inlined
def _is_whole(magnitude: float) -> bool:
    """Return whether a number >= 0 is an integer; all numbers from 2**52 on, and infinity, count as integers."""
    rounded = (magnitude + TWO_52) - TWO_52
    return (magnitude if magnitude >= TWO_52 else rounded) == magnitude


@inlined
def strict_pow(x: float, y: float) -> float:
    """Return x**y for x > 0, for x = 0 <= y, and for x < 0 with integer y; NaN for all other arguments.

    So negative powers of 0 are NaN, not infinity. x**0 is 1, also 0**0, but NaN**0 is NaN. 1**infinity is 1. Infinite
    arguments follow IEEE 754. The measured error is at most 1.1 ulp, also for subnormal results, because the logarithm
    is a pair of numbers.
    """
    magnitude = abs(x)
    high, low = _logarithm_pair(magnitude)
    high = high if magnitude < INFINITY else magnitude
    high = -INFINITY if magnitude == 0.0 else high
    factor = HUGE_POWER if y > HUGE_POWER else y
    factor = -HUGE_POWER if factor < -HUGE_POWER else factor
    exponent, error = _two_product(factor, high)
    error = error + factor * low
    value = _exponential(exponent, error if abs(exponent) < 1000.0 else 0.0)
    power = abs(y)
    odd_value = -value if _is_whole(power) else NAN
    negative_value = value if _is_whole(0.5 * power) else odd_value
    value = value if x >= 0.0 else negative_value
    value = NAN if (magnitude == 0.0) & (y < 0.0) else value
    return 1.0 if (y == 0.0) & (x == x) else value
