"""Sums of products: a normal form of expressions that makes many rules of real algebra unnecessary.

A `Sum` maps monomials to coefficients, and a `Monomial` maps atoms to integer powers; both are sorted. An `Atom` is a
variable, a function of a sum, a power with any exponent, or a sum of several terms as a factor. Two expressions have
the same form if they differ only in the order of terms and factors, in like terms, in cancelling quotients or in
products of constants. The constructors below also bring functions to a normal form: a phase lies within an eighth of a
turn of 0, arguments begin with a positive term, and a product has at most one exponential.

The normal form may have a value where the original expression has none: ``x/x`` becomes 1.

The parts of this module depend on each other, so they cannot be separate modules: products call functions of sums to
join exponentials, powers and roots, and functions of sums call products.
"""

import logging
import math
from collections import Counter
from collections.abc import Callable, Iterable
from functools import lru_cache, partial, wraps
from typing import Any, Final, ParamSpec, TypeAlias, TypeVar

from atoll_core.expression import operators as op
from atoll_core.expression.evaluation import value_of

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")
FAILURES: Final[Counter[str]] = Counter()
"""Number of failed rewritings by function and kind of error."""


def contained(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Turn any error in rewriting into an `UndefinedError`; callers then keep the expression unchanged.

    Rewriting only decides how an equation is displayed, so a bug in the code of rewriting must not end an island or a
    job. Each kind of failure is logged once. A failure depends only on the program, so equal seeds still give equal
    bits.
    """

    @wraps(function)
    def guarded(*arguments: Arguments.args, **named: Arguments.kwargs) -> Result:
        try:
            return function(*arguments, **named)
        except UndefinedError:
            raise
        except Exception as error:
            kind = f"{function.__name__}: {type(error).__name__}"
            FAILURES[kind] += 1
            if FAILURES[kind] == 1:
                logging.getLogger(__name__).warning("an expression stays as it was, rewriting failed: %s", kind)
            raise UndefinedError from error

    return guarded


Atom: TypeAlias = tuple[Any, ...]
"""``(VARIABLE, index)``, ``(code of a function, Sum)``, ``(ADD, Sum)`` or ``(POW, Sum, Sum)``: the first element
determines the types of the other elements. Type hints cannot express this."""
Monomial: TypeAlias = tuple[tuple[Atom, int], ...]
Sum: TypeAlias = tuple[tuple[Monomial, float], ...]

ONE: Final[Monomial] = ()
ZERO: Final[Sum] = ()
LARGEST_POWER: Final = 16
"""Largest whole power of a factor."""
_ROUNDING: Final = 1e-13
"""A sum that is smaller than this share of its terms is a rounding error."""
_PHASE: Final = 1e-9
"""Tolerance in radians: a phase this close to a multiple of a quarter turn is that multiple."""
_QUARTER: Final = math.pi / 2


class UndefinedError(Exception):
    """Raised if a part has no finite value, as in a division by zero, or if a power is too large."""


def constant(value: float) -> Sum:
    """Return a number as a sum; raises UndefinedError if it is not finite."""
    if not math.isfinite(value):
        raise UndefinedError
    return ((ONE, value),) if value else ZERO


def variable(index: int) -> Sum:
    """Return a variable as a sum."""
    return (((((op.VARIABLE, index), 1),), 1.0),)


def split_constant(terms: Sum) -> tuple[float, Sum]:
    """Return the constant term of a sum, and the rest."""
    return (terms[0][1], terms[1:]) if terms and terms[0][0] == ONE else (0.0, terms)


def number_of(terms: Sum) -> float | None:
    """If a sum is only a number, return this number as a float. Return None for other sums."""
    number, rest = split_constant(terms)
    return None if rest else number


def cleaned(value: float) -> float:
    """Return the nearest number with twelve digits, if it differs only by a few rounding errors. If not, return
    `value`."""
    if not math.isfinite(value):
        raise UndefinedError
    return value if value.is_integer() else _rounded(value)


@lru_cache(maxsize=50_000)
def _rounded(value: float) -> float:
    short = float(f"{value:.12g}")
    return short if abs(short - value) <= 4.0 * math.ulp(value) else value


def nonzero(value: float) -> float:
    """Return `value`, a product of nonzero numbers. Raises UndefinedError if it is 0 or not finite.

    A coefficient may underflow, as in (1e-170 x)(1e-170 y), although the whole term does not, if the variables are
    large.
    """
    if not value or not math.isfinite(value):
        raise UndefinedError
    return value


def times(one: float, other: float) -> float:
    """Return the product. Raises UndefinedError if the product is not finite, or if it is 0 and no factor is 0."""
    return nonzero(one * other) if one and other else 0.0


def add(*parts: tuple[float, Sum]) -> Sum:
    """Return the sum of multiples of sums."""
    every: list[tuple[Monomial, float]] = []
    for factor, terms in parts:
        every += terms if factor == 1.0 else [(monomial, times(factor, number)) for monomial, number in terms]
    return collect(every)


def collect(terms: Iterable[tuple[Monomial, float]]) -> Sum:
    """Return the sum of terms.

    Like terms are joined, terms that are a single bracket are expanded, and cancelling terms are dropped.

    Raises UndefinedError if terms are too large to decide whether they cancel.
    """
    sums: dict[Monomial, list[float]] = {}  # coefficient, and sum of absolute values
    waiting = list(terms)
    while waiting:
        monomial, coefficient = waiting.pop()
        if _is_lone_bracket(monomial):
            waiting += [(inner, times(coefficient, factor)) for inner, factor in monomial[0][0][1]]
            continue
        known = sums.get(monomial)
        if known is None:
            sums[monomial] = [coefficient, abs(coefficient)]
        else:
            known[0] += coefficient
            known[1] += abs(coefficient)
    if not all(math.isfinite(size) for _, size in sums.values()):
        raise UndefinedError
    left = [(monomial, cleaned(value)) for monomial, (value, size) in sums.items() if abs(value) > _ROUNDING * size]
    return tuple(sorted(left)) if len(left) > 1 else tuple(left)


def _is_lone_bracket(monomial: Monomial) -> bool:
    return len(monomial) == 1 and monomial[0][1] == 1 and monomial[0][0][0] == op.ADD


def multiply(left: Sum, right: Sum) -> Sum:
    """Return the product. A factor with several terms is written as a bracket and not expanded."""
    for one, other in ((left, right), (right, left)):
        number = number_of(one)
        if number is not None:
            return scaled(other, number) if number else ZERO
    return product([*_factors(left, 1), *_factors(right, 1)])


def scaled(terms: Sum, factor: float) -> Sum:
    """Return a multiple of a sum by a nonzero factor; raises UndefinedError if a term would underflow."""
    if factor == 1.0:
        return terms
    return tuple((monomial, cleaned(nonzero(factor * coefficient))) for monomial, coefficient in terms)


def raised_number(value: float, exponent: int) -> float:
    """Return an integer power of a number; raises UndefinedError if it is not finite, or underflows."""
    try:
        raised = float(value**exponent)
        return nonzero(raised) if value else raised
    except (OverflowError, ZeroDivisionError):
        raise UndefinedError from None


def power(base: Sum, exponent: int) -> Sum:
    """Return an integer power; raises UndefinedError for zero to a negative power."""
    if exponent == 0:
        return constant(1.0)
    if not base:
        if exponent < 0:
            raise UndefinedError
        return ZERO
    return base if exponent == 1 else product(_factors(base, exponent))


def distribute(left: Sum, right: Sum) -> Sum:
    """Return the expanded product: every term of one sum is multiplied by every term of the other."""
    return add(*((times(one, two), product([*monomial, *other])) for monomial, one in left for other, two in right))


def _factors(terms: Sum, exponent: int) -> list[tuple[Atom, int] | float]:
    """Return the factors of a power of a sum: a number, and atoms with their exponents."""
    coefficient, monomial = bracket_or_term(terms)
    return [raised_number(coefficient, exponent), *((atom, count * exponent) for atom, count in monomial)]


def bracket(terms: Sum) -> tuple[float, Monomial]:
    """Return a sum of several terms as a number times a monomial. Common factors are in front of the bracket.

    After common factors are taken out, terms may cancel: x^2 - x (x - 1) is x.
    """
    shared = common([monomial for monomial, _ in terms])
    rest = collect((divided(monomial, shared), coefficient) for monomial, coefficient in terms) if shared else terms
    if len(rest) < 2:
        return (rest[0][1], merged([*shared, *rest[0][0]])) if rest else (0.0, ONE)
    lead = next(coefficient for monomial, coefficient in rest if monomial != ONE)
    unit = tuple((monomial, cleaned(nonzero(coefficient / lead))) for monomial, coefficient in rest)
    return lead, merged([*shared, ((op.ADD, unit), 1)])


def common(monomials: Iterable[Monomial]) -> Monomial:
    """Return the largest monomial that divides all terms; common negative powers are included."""
    first, *others = (dict(monomial) for monomial in monomials)
    shared: list[tuple[Atom, int]] = []
    for atom, exponent in first.items():
        exponents = [exponent, *(other.get(atom, 0) for other in others)]
        if min(exponents) > 0 or max(exponents) < 0:
            shared.append((atom, min(exponents, key=abs)))
    return tuple(shared)


def divided(monomial: Monomial, divisor: Monomial) -> Monomial:
    """Return the quotient of two monomials."""
    return merged([*monomial, *((atom, -exponent) for atom, exponent in divisor)])


def merged(factors: Iterable[tuple[Atom, int]]) -> Monomial:
    """Return the product of powers of atoms, with equal atoms joined."""
    total: dict[Atom, int] = {}
    for atom, exponent in factors:
        total[atom] = total.get(atom, 0) + exponent
    if any(abs(exponent) > LARGEST_POWER for exponent in total.values()):
        raise UndefinedError
    return tuple(sorted(item for item in total.items() if item[1]))


def product(factors: Iterable[tuple[Atom, int] | float]) -> Sum:
    """Return the product of numbers and powers of atoms. It has at most one exponential, and no squares of roots."""
    coefficient, powers = 1.0, []
    for factor in factors:
        if isinstance(factor, float):
            coefficient = times(coefficient, factor)
        else:
            powers.append(factor)
    monomial = merged(powers)
    if any(
        atom[0] in (op.EXP, op.POW, op.SQRT) or (atom[0] == op.ABS and abs(exponent) > 1) for atom, exponent in monomial
    ):
        return _reduced(coefficient, monomial)
    if not coefficient:
        return ZERO
    term = (monomial, cleaned(coefficient))
    return collect([term]) if _is_lone_bracket(monomial) else (term,)


def _reduced(coefficient: float, monomial: Monomial) -> Sum:
    """Return a product with its exponentials, powers and roots joined."""
    known: dict[Atom, int] = {}
    exponents: list[tuple[float, Sum]] = []
    powers: dict[Sum, list[tuple[float, Sum]]] = {}
    roots: list[tuple[Sum, int]] = []
    for atom, count in monomial:
        if atom[0] == op.EXP:
            exponents.append((float(count), atom[1]))
        elif atom[0] == op.POW:
            powers.setdefault(atom[1], []).append((float(count), atom[2]))
        elif atom[0] == op.SQRT:
            roots.append((atom[1], count))
        elif atom[0] == op.ABS:
            odd = int(math.fmod(count, 2))
            known[atom] = known.get(atom, 0) + odd
            coefficient = times(coefficient, _multiplied(known, atom[1], count - odd))
        else:
            known[atom] = known.get(atom, 0) + count
    for argument, count in roots:
        if argument in powers:
            powers[argument].append((float(count), constant(0.5)))
            continue
        halves = count + 2 * known.pop(_lone_atom(argument), 0)
        odd = int(math.fmod(halves, 2))
        known[(op.SQRT, argument)] = odd
        coefficient = times(coefficient, _multiplied(known, argument, (halves - odd) // 2))
    if exponents:
        coefficient = times(coefficient, _multiplied(known, function(op.EXP, add(*exponents)), 1))
    for base, parts in powers.items():
        whole = float(known.pop(_lone_atom(base), 0))
        coefficient = times(coefficient, _multiplied(known, raised(base, add(*parts, (whole, constant(1.0)))), 1))
    return collect([(merged(known.items()), cleaned(coefficient))]) if coefficient else ZERO


def _multiplied(factors: dict[Atom, int], terms: Sum, exponent: int) -> float:
    """Multiply `factors` by a power of a sum, and return the number that remains of this power."""
    if not exponent:
        return 1.0
    if not terms:
        return 0.0
    number, monomial = bracket_or_term(terms)
    for atom, count in monomial:
        factors[atom] = factors.get(atom, 0) + count * exponent
    return raised_number(number, exponent)


def _lone_atom(terms: Sum) -> Atom:
    """If a sum is a single atom, return this atom; if not, return an empty atom."""
    number, monomial = bracket_or_term(terms)
    return monomial[0][0] if number == 1.0 and len(monomial) == 1 and monomial[0][1] == 1 else ()


def bracket_or_term(terms: Sum) -> tuple[float, Monomial]:
    """Return a sum as a number times a monomial; raises UndefinedError for zero."""
    if len(terms) == 1:
        return terms[0][1], terms[0][0]
    if not terms:
        raise UndefinedError
    return bracket(terms)


# ------------------------------------------------------------------------------------------------------- functions


def function(code: int, argument: Sum) -> Sum:
    """Return a function of a sum, in normal form."""
    number = number_of(argument)
    if number is not None:
        return constant(value_of(code, number, 0.0))
    return _FORMS[code](argument) if code in _FORMS else atom_sum((code, argument))


def atom_sum(atom: Atom, coefficient: float = 1.0, exponent: int = 1) -> Sum:
    """Return a multiple of a power of an atom."""
    return ((((atom, exponent),), coefficient),)


def unsigned(terms: Sum) -> tuple[float, Sum]:
    """Return a sum as a sign times a sum whose first term with a variable is positive."""
    lead = next(coefficient for monomial, coefficient in terms if monomial != ONE)
    return (1.0, terms) if lead > 0.0 else (-1.0, scaled(terms, -1.0))


def _wave(code: int, argument: Sum) -> Sum:
    phase, rest = split_constant(argument)
    sign, rest = unsigned(rest)
    # Let r be the rest, p the phase, and q the quarter turns that turn a cosine into a sine: sin(-r + p + q) = -sin(r -
    # p - q).
    quarters = round(phase / _QUARTER)
    left = sign * (phase - quarters * _QUARTER)
    quarters = int(sign) * (quarters + (code == op.COS)) % 4
    inner = collect([(ONE, left), *rest]) if abs(left) > _PHASE else rest
    return atom_sum((op.COS if quarters % 2 else op.SIN, inner), sign if quarters < 2 else -sign)


def _exponential(argument: Sum) -> Sum:
    shift, rest = split_constant(argument)
    number = value_of(op.EXP, shift, 0.0) if shift else 1.0
    if not 0.0 < number < math.inf:
        raise UndefinedError
    whole: list[tuple[Atom, int]] = []
    left: list[tuple[Monomial, float]] = []
    for monomial, coefficient in rest:
        is_log = len(monomial) == 1 and monomial[0][1] == 1 and monomial[0][0][0] == op.LOG
        if is_log and coefficient.is_integer() and abs(coefficient) <= LARGEST_POWER:
            scale, factors = bracket_or_term(monomial[0][0][1])
            number = times(number, raised_number(scale, int(coefficient)))
            whole += [(atom, exponent * int(coefficient)) for atom, exponent in factors]
        else:
            left.append((monomial, coefficient))
    if not left:
        return product([number, *whole])
    return product([number, *whole, ((op.EXP, tuple(left)), 1)]) if whole else atom_sum((op.EXP, tuple(left)), number)


def _logarithm(argument: Sum) -> Sum:
    monomial, coefficient = argument[0]
    if len(argument) > 1 or coefficient < 0.0:
        return atom_sum((op.LOG, argument))
    parts: list[tuple[float, Sum]] = [(1.0, constant(value_of(op.LOG, coefficient, 0.0)))]
    rest: list[tuple[Atom, int]] = []
    for atom, exponent in monomial:
        if atom[0] == op.EXP:
            parts.append((float(exponent), atom[1]))
        else:
            rest.append((atom, exponent))
    if len(rest) == 1 and rest[0][1] % 2:
        ((atom, exponent),) = rest
        is_root = atom[0] == op.SQRT
        logarithm = function(op.LOG, atom[1]) if is_root else atom_sum((op.LOG, collect(atom_sum(atom))))
        parts.append((0.5 * exponent if is_root else float(exponent), logarithm))
    elif rest:
        parts.append((1.0, atom_sum((op.LOG, collect([(tuple(rest), 1.0)])))))
    return add(*parts)


def _root(argument: Sum) -> Sum:
    monomial, coefficient = argument[0]
    if len(argument) > 1 or coefficient < 0.0:
        return atom_sum((op.SQRT, argument))
    number = math.sqrt(coefficient)
    if len(monomial) == 1:
        ((atom, exponent),) = monomial
        if atom[0] == op.EXP:
            return multiply(constant(number), function(op.EXP, add((0.5, atom[1]))))
        if exponent % 2 == 0:
            return multiply(constant(number), power(function(op.ABS, collect(atom_sum(atom))), exponent // 2))
        if exponent < 0:
            inverse = collect(atom_sum(atom, exponent=-exponent))
            return multiply(constant(number), power(function(op.SQRT, inverse), -1))
    return product([number, ((op.SQRT, collect([(monomial, 1.0)])), 1)])


def _hyperbolic_tangent(argument: Sum) -> Sum:
    sign, positive = unsigned(argument)
    return atom_sum((op.TANH, positive), sign)


def _magnitude(argument: Sum) -> Sum:
    if len(argument) != 1:
        return atom_sum((op.ABS, unsigned(argument)[1]))
    ((monomial, coefficient),) = argument
    positive = [
        (atom, exponent) for atom, exponent in monomial if atom[0] in (op.EXP, op.SQRT, op.ABS) or exponent % 2 == 0
    ]
    rest = tuple(item for item in monomial if item not in positive)
    parts: list[tuple[Atom, int] | float] = [abs(coefficient), *positive]
    if rest:
        parts.append(((op.ABS, collect([(rest, 1.0)])), 1))
    return product(parts)


_FORMS: Final[dict[int, Callable[[Sum], Sum]]] = {
    op.SIN: partial(_wave, op.SIN),
    op.COS: partial(_wave, op.COS),
    op.EXP: _exponential,
    op.LOG: _logarithm,
    op.SQRT: _root,
    op.ABS: _magnitude,
    op.TANH: _hyperbolic_tangent,
}


def raised(base: Sum, exponent: Sum) -> Sum:
    """Return a power with any exponent."""
    number, basis = number_of(exponent), number_of(base)
    if number is not None and basis is not None:
        return constant(value_of(op.POW, basis, number))
    if number is not None:
        if number.is_integer() and abs(number) <= LARGEST_POWER:
            return power(base, int(number))
        if abs(number) == 0.5:
            return power(function(op.SQRT, base), 1 if number > 0.0 else -1)
        if len(base) == 1 and base[0][1] > 0.0 and base[0][1] != 1.0:
            scale = nonzero(value_of(op.POW, base[0][1], number))
            return multiply(constant(scale), atom_sum((op.POW, ((base[0][0], 1.0),), exponent)))
    if basis == 1.0:
        return constant(1.0)
    return atom_sum((op.POW, base, exponent))
