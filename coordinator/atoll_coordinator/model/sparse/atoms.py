"""The dictionary of terms: products of variables, products with functions that have an inner constant, and libraries of
terms.

A `Product` is a tuple of variables. A `Shape` is a product times a function, with its values on some rows; the function
may have an inner constant. An `Atom` is a shape with a value of this constant: a term of a sum without its coefficient.
Terms for which no values are needed are expressions. Doubt: the grids of inner constants are relative to the root mean
square of a variable. They can miss a function that varies only in a small part of the range of the variable.

Letters: K terms, R rows, V variables.
"""

from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from itertools import combinations, combinations_with_replacement
from typing import Final, cast

import numpy as np

from atoll_coordinator.model.description_length import constant_nats_of, structure_length
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.operators import (
    ABS,
    ADD,
    ARITY,
    CONSTANT,
    COS,
    DIVIDE,
    EXP,
    LOG,
    MULTIPLY,
    POW,
    SIN,
    SQRT,
    SUBTRACT,
    TANH,
    VARIABLE,
)
from atoll_core.expression.program import Expression, Program, ProgramBuilder, constant_places
from atoll_core.expression.simplification import simplify_program
from atoll_core.expression.writing.expansion import terms_of
from atoll_core.expression.writing.shortest import collected
from atoll_core.expression.writing.sums_of_products import UndefinedError

# ------------------------------------------------------------------------------------------------ terms and sums

Product = tuple[int, ...]
"""Indices of variables in ascending order, repeated for powers; empty: the constant term."""


def product_of(factors: Sequence[Expression]) -> Expression:
    """Return the product of `factors`; 1 if there are no factors."""
    product = factors[0] if factors else 1.0
    for factor in factors[1:]:
        product = (MULTIPLY, product, factor)
    return product


def scaled(term: Expression, factor: float) -> Expression:
    """Return a term times a number. The number becomes the first factor, or replaces a numerator of 1."""
    match term:
        case (code, first, second) if code in (MULTIPLY, DIVIDE):
            return (code, scaled(first, factor), second)
    return factor if term == 1.0 else (MULTIPLY, factor, term)


def sum_of(terms: Sequence[Expression], coefficients: Sequence[float]) -> Program:
    """Return the program of the sum of `terms`, in their order, with these coefficients."""
    total, *others = (scaled(term, float(factor)) for term, factor in zip(terms, coefficients, strict=True))
    for other in others:
        total = (ADD, total, other)
    builder = ProgramBuilder()
    return simplify_program(builder.program(builder.build(total)))


def products(columns: Sequence[int], degree: int) -> list[Product]:
    """Return all products of these variables up to a degree, the constant first."""
    return [term for order in range(degree + 1) for term in combinations_with_replacement(columns, order)]


def values_of_products(terms: Sequence[Product], inputs: FloatArray) -> FloatArray:
    """Return the values (K, R) of products at `inputs` (V, R); factors are multiplied in their order."""
    values = np.ones((len(terms), inputs.shape[1]))
    for row, term in zip(values, terms, strict=True):
        for variable in term:
            row *= inputs[variable]
    return values


def expression_of(term: Product) -> Expression:
    """Return a product as an expression."""
    return product_of([(VARIABLE, variable) for variable in term])


def products_of(program: Program, degree: int) -> list[Product] | None:
    """Return the products in the sum `program`; None if the program is no sum of products up to this degree."""
    try:
        monomials = [monomial for monomial, _ in terms_of(program)]
    except UndefinedError:
        return None
    found: list[Product] = []
    for monomial in monomials:
        if any(atom[0] != VARIABLE or exponent < 0 for atom, exponent in monomial):
            return None
        found.append(tuple(sorted(atom[1] for atom, exponent in monomial for _ in range(exponent))))
    return sorted(found, key=lambda term: (len(term), term)) if max(map(len, found), default=0) <= degree else None


# ----------------------------------------------------------------------------------------------------- libraries


def polynomial_libraries(
    columns: Sequence[int], rows: float, degrees: Sequence[int]
) -> Iterator[tuple[list[Product], bool]]:
    """Yield, for each possible degree, all products up to this degree, and whether the highest degree is possible.

    `rows` is the number of independent rows; each term of a library needs `rows_per_term` of them.
    """
    candidates = [products(columns, degree) for degree in degrees]
    most = min(SETTINGS.sparse.largest_library, rows / SETTINGS.sparse.rows_per_term)
    allowed = [terms for terms in candidates if len(terms) <= most]
    for terms in allowed:
        yield terms, len(allowed) == len(candidates)


def polynomial_and_fourier_libraries(
    variables: Sequence[int], operators: Collection[int]
) -> Iterator[list[Expression]]:
    """Yield libraries of terms in these variables. A library is yielded if the operators (codes) allow its terms; its
    first term is the constant term.

    The libraries are: products up to the second and up to the third degree; products with sines and cosines; products
    of sines and cosines; sines and cosines of sums and differences, as in coupled phases.
    """
    if not {ADD, MULTIPLY} <= set(operators):
        return
    plain: list[Expression] = [(VARIABLE, variable) for variable in variables]
    waves: list[Expression] = [(code, variable) for variable in plain for code in (SIN, COS)]
    candidates = [list(map(expression_of, products(variables, degree))) for degree in (2, 3)]
    if {SIN, COS} <= set(operators):
        candidates += [[*candidates[0], *waves], [1.0, *waves, *map(product_of, combinations(waves, 2))]]
        if SUBTRACT in operators:
            pairs = list(combinations(plain, 2))
            phases = [(join, *pair) for pair in pairs for join in (SUBTRACT, ADD)]
            candidates.append([1.0, *waves, *((code, phase) for phase in phases for code in (SIN, COS))])
    yield from (terms for terms in candidates if len(terms) <= SETTINGS.effort.longest_sum)


# ----------------------------------------------------------------------------------------------------- functions

_RATES: Final = (0.3, 0.6, 1.2, 2.4, 4.8, 9.6)
_BOTH_SIGNS: Final = tuple(sign * 0.1 * 2.0 ** (step / 2.0) for sign in (1.0, -1.0) for step in range(13))
"""Grid of rates of exponentials. This grid is finer than `_RATES`, because many rates fit about as well if a variable
stays far from 0."""
_SHIFTS: Final = tuple(0.0125 * 2.0 ** (step / 2.0) for step in range(17))
_KINKS: Final = tuple(eighth / 8.0 for eighth in range(1, 8))
"""Shares of the range of a variable at which its function has a kink."""
_EXPONENTS: Final = (-1.5, -0.5, 0.3, 0.7, 1.5, 2.5)


@dataclass(frozen=True, eq=False)
class Function:
    """A function of an argument u (R,) and an inner constant.

    `slope` is the derivative by the constant, None if there is no constant. `constants` returns start values of the
    constant for an argument u with a given root mean square. `name` is its key in `FUNCTIONS`; functions that only
    differ in the start values have the same name.
    """

    value: Callable[[FloatArray, float], FloatArray]
    expression: Callable[[Expression, float], Expression]
    slope: Callable[[FloatArray, float], FloatArray] | None = None
    constants: Callable[[float], Sequence[float]] = lambda _: (1.0,)
    has_pole: bool = False
    name: str = ""


def _make_scaled_function(code: int, rates: Sequence[float], value: Callable[[FloatArray], FloatArray],
               slope: Callable[[FloatArray], FloatArray]) -> Function:  # fmt: skip
    """Return a function of c u with the inner constant c."""
    return Function(
        lambda u, c: value(c * u),
        lambda u, c: (code, scaled(u, c)),
        lambda u, c: u * slope(c * u),
        lambda size: [rate / size for rate in rates],
        name=f"{code} of a multiple",
    )


def _make_plain_function(code: int, value: Callable[[FloatArray], FloatArray]) -> Function:
    return Function(lambda u, _: value(u), lambda u, _: (code, u), name=f"{code}")


_OVER: Final = Function(lambda u, _: 1.0 / u, lambda u, _: (DIVIDE, 1.0, u), has_pole=True, name="inverse")
_OVER_SUM: Final = Function(
    lambda u, c: 1.0 / (u + c),
    lambda u, c: (DIVIDE, 1.0, (ADD, u, c)),
    lambda u, c: -1.0 / (u + c) ** 2,
    has_pole=True,
    name="inverse of a sum",
)
_POWER: Final = Function(
    lambda u, c: u**c, lambda u, c: (POW, u, c), lambda u, c: u**c * np.log(u), lambda _: _EXPONENTS, name="power"
)
_SIGN: Final = Function(lambda u, _: np.sign(u), lambda u, _: (DIVIDE, u, (ABS, u)), name="sign")
_KINK: Final = Function(
    lambda u, c: np.abs(u - c),
    lambda u, c: (ABS, (ADD, u, -c)),
    lambda u, c: np.sign(c - u),
    name="kink",
)
_EXP: Final = _make_scaled_function(EXP, _BOTH_SIGNS, np.exp, np.exp)
_OF_ANY: Final = {
    SIN: _make_scaled_function(SIN, _RATES, np.sin, np.cos),
    COS: _make_scaled_function(COS, _RATES, np.cos, lambda u: -np.sin(u)),
    EXP: _EXP,
    TANH: _make_scaled_function(TANH, _RATES, np.tanh, lambda u: 1.0 - np.tanh(u) ** 2),
}
"""Functions of any argument, by the operator that they need."""
_OF_SQUARES: Final = {EXP: _EXP}
_WAVES: Final = {SIN: _make_plain_function(SIN, np.sin), COS: _make_plain_function(COS, np.cos)}
_ABS: Final = _make_plain_function(ABS, np.abs)
_OF_POSITIVE: Final = {LOG: _make_plain_function(LOG, np.log), SQRT: _make_plain_function(SQRT, np.sqrt), POW: _POWER}

FUNCTIONS: Final = {
    function.name: function
    for function in (
        _OVER, _OVER_SUM, _SIGN, _KINK, _ABS, *_OF_ANY.values(), *_WAVES.values(), *_OF_POSITIVE.values()
    )
}  # fmt: skip
"""All functions by name."""


# --------------------------------------------------------------------------------------------- shapes and atoms


@dataclass(frozen=True, eq=False)
class Shape:
    """A product of variables, and possibly a function of `u` (R,) as another factor.

    `factors` are the indices of the variables, and `product` (R,) are the values of their product. `argument` is the
    expression for u.
    """

    factors: Product
    product: FloatArray
    function: Function | None = None
    argument: Expression = 0.0
    u: FloatArray | None = None

    @property
    def has_constant(self) -> bool:
        """Whether there is an inner constant."""
        return self.function is not None and self.function.slope is not None

    def constants(self) -> Sequence[float]:
        """Return the start values of the inner constant."""
        if self.function is None or self.u is None:
            return (1.0,)
        size = float(np.sqrt(np.mean(self.u**2)))
        return self.function.constants(size) if size > 0.0 else ()

    def value(self, constant: float) -> FloatArray:
        """Return the values (R,). All values are NaN if a pole lies between the rows."""
        return self.product if self.function is None else np.asarray(self.product * self.function_values(constant))

    def function_values(self, constant: float) -> FloatArray:
        """Return the values (R,) of the function, which must exist. All values are NaN if a pole lies between the
        rows."""
        assert self.function is not None
        assert self.u is not None
        values = self.function.value(self.u, constant)
        if self.function.has_pole and (values > 0.0).any() and (values < 0.0).any():
            return np.full_like(values, np.nan)
        return values

    def over(self, inputs: FloatArray) -> "Shape":
        """Return the same shape on other rows of the variables, `inputs` (V, R)."""
        return shape_over(inputs, self.factors, self.function, self.argument)

    def expression(self, constant: float) -> Expression:
        """Return the product with this inner constant."""
        product = expression_of(self.factors)
        if self.function is None:
            return product
        match self.function.expression(self.argument, constant):
            case (code, 1.0, below) if code == DIVIDE:
                return (DIVIDE, product, below)
            case function:
                return (MULTIPLY, product, function) if self.factors else function

    def price(self, rows: float) -> float:
        """Return the nats of the term in a sum: the price of its structure, and 1/2 ln N for each constant, where N is
        `rows`."""
        structure, constants = self._structure_and_constants
        return structure + constants * constant_nats_of(rows)

    @cached_property
    def _structure_and_constants(self) -> tuple[float, int]:
        return _structure_and_constants(self.expression(1.5))


def shape_over(inputs: FloatArray, factors: Product, function: Function | None, argument: Expression) -> Shape:
    """Return a shape with its values on some rows of the variables, `inputs` (V, R)."""
    product = values_of_products([factors], inputs)[0]
    if function is None:
        return Shape(factors, product)
    builder = ProgramBuilder()
    return Shape(factors, product, function, argument, values_of(builder.program(builder.build(argument)), inputs))


@lru_cache(maxsize=20_000)
def _structure_and_constants(expression: Expression) -> tuple[float, int]:
    """Return the nats of the structure of a term in a sum, and its number of constants."""
    program = sum_of([expression], [2.5])
    return structure_length(program), len(constant_places(program))


@dataclass(frozen=True, eq=False)
class Atom:
    """A term without its coefficient: a shape and its inner constant."""

    shape: Shape
    constant: float = 1.0

    @property
    def values(self) -> FloatArray:
        """The values (R,)."""
        return self.shape.value(self.constant)

    def over(self, inputs: FloatArray) -> "Atom":
        """Return the same term on other rows of the variables, `inputs` (V, R)."""
        return Atom(self.shape.over(inputs), self.constant)

    def move_constant(self, step: float) -> "Atom":
        """Return the term after a step of its inner constant. The step is limited to half of the constant."""
        limit = 0.5 * abs(self.constant)
        return Atom(self.shape, self.constant + min(max(step, -limit), limit))

    def derivative_by_constant(self) -> "Atom":
        """Return the derivative by the inner constant as a term. The term must have an inner constant; the derivative
        has no expression."""
        assert self.shape.function is not None
        assert self.shape.function.slope is not None
        slope = replace(self.shape.function, value=self.shape.function.slope, slope=None, has_pole=False)
        return Atom(replace(self.shape, function=slope), self.constant)

    def depends_on(self, variable: int) -> bool:
        """Tell whether a variable (index) is a factor or occurs in the argument of the function."""
        return variable in self.shape.factors or _contains_variable(self.shape.argument, variable)


@dataclass(frozen=True)
class Term:
    """An atom without values: its factors, the name of its function (None: no function) and its argument, and its inner
    constant. It can be sent to other machines."""

    factors: Product
    function: str | None
    argument: Hashable
    constant: float

    @classmethod
    def of(cls, atom: Atom) -> "Term":
        """Return an atom without its values."""
        shape = atom.shape
        return cls(
            shape.factors, None if shape.function is None else shape.function.name, shape.argument, atom.constant
        )

    def over(self, inputs: FloatArray) -> Atom:
        """Return the atom with its values on some rows of the variables, `inputs` (V, R)."""
        function = None if self.function is None else FUNCTIONS[self.function]
        return Atom(shape_over(inputs, self.factors, function, cast(Expression, self.argument)), self.constant)


def _contains_variable(expression: object, variable: int) -> bool:
    if not isinstance(expression, tuple):
        return False
    if len(expression) == 2 and expression[0] == VARIABLE:
        return bool(expression[1] == variable)
    return any(_contains_variable(part, variable) for part in expression[1:])


def program_of(atoms: Sequence[Atom], coefficients: Iterable[float]) -> Program:
    """Return the sum of terms with these coefficients (K,), as a sum of products."""
    return collected(sum_of([atom.shape.expression(atom.constant) for atom in atoms], [*coefficients]))


def powers(inputs: FloatArray, terms: Sequence[Product]) -> list[Shape]:
    """Return products of the variables `inputs` (V, R) as shapes."""
    return [Shape(*pair) for pair in zip(terms, values_of_products(terms, inputs), strict=True)]


def program_atom(program: Program, inputs: FloatArray) -> Atom:
    """Return a program as a term, with its values at `inputs` (V, R)."""
    parts: list[Expression] = []
    for code, left, right, value in program.nodes():
        arguments = [parts[place] for place in (left, right)[: ARITY[code]]]
        parts.append(value if code == CONSTANT else (VARIABLE, left) if code == VARIABLE else (code, *arguments))
    itself = Function(lambda u, _: u, lambda u, _: u)
    return Atom(Shape((), np.ones(inputs.shape[1]), itself, parts[-1], values_of(program, inputs)))


def product_atoms(inputs: FloatArray, terms: Sequence[Product]) -> tuple[Atom, ...]:
    """Return products of the variables `inputs` (V, R) as atoms."""
    return tuple(map(Atom, powers(inputs, terms)))


def products_with_functions(
    inputs: FloatArray, columns: Sequence[int], operators: Collection[int], most: int = SETTINGS.sparse.most_atoms
) -> list[Shape]:
    """Return products of a function and up to two variables. If there are more than `most` atoms, products have fewer
    variables.

    If there are too many atoms with two variables, only quotients have two variables: most laws with many variables
    have quotients.
    """
    both = _products_up_to_degree(inputs, columns, operators, 2, most)
    if both is not None:
        return both
    quotients = _products_up_to_degree(inputs, columns, {DIVIDE} & set(operators), 2, most)
    rest = set(operators) if quotients is None else set(operators) - {DIVIDE}
    fewer = (_products_up_to_degree(inputs, columns, rest, degree, most) for degree in (1, 0))
    return [*(quotients or ()), *next((found for found in fewer if found is not None), [])]


def _products_up_to_degree(
    inputs: FloatArray, columns: Sequence[int], operators: Collection[int], degree: int, most: int
) -> list[Shape] | None:
    """Return products of a function and of variables, up to this degree. None if there are more than `most` atoms."""
    plain = powers(inputs, products(columns, degree))
    arguments = list(_arguments(inputs, columns, set(operators)))
    single = [Shape((), plain[0].product, function, argument, u) for argument, u, of in arguments for function in of]
    if len(plain) * sum(len(shape.constants()) for shape in single) > most:
        return None
    return [
        Shape(product.factors, product.product, function, argument, u)
        for argument, u, functions in arguments
        for product in plain
        for function in functions
    ]


def _quotients(values: FloatArray, column: int) -> Iterator[tuple[Expression, FloatArray, list[Function]]]:
    """Yield powers u of a variable with the function 1/(c + u). The start values of c are the same powers of shares of
    the variable's root mean square. If u is the variable itself, the pole may also lie beyond its largest value. An
    example is a process that saturates in the remaining part of a conserved amount.
    """
    leaf: Expression = (VARIABLE, column)
    square: Expression = (MULTIPLY, leaf, leaf)
    arguments: tuple[Expression, ...] = (leaf, square, (MULTIPLY, leaf, square), (MULTIPLY, square, square))
    for exponent, argument in enumerate(arguments, 1):
        yield argument, values**exponent, [replace(_OVER_SUM, constants=partial(_powers_of_shifts, exponent))]
    yield leaf, values, [replace(_OVER_SUM, constants=partial(_shifts_beyond_range, float(values.max())))]


def _shifts_beyond_range(most: float, size: float) -> Sequence[float]:
    """Return shifts whose pole is beyond `most`, the largest value of a variable; `size` is its root mean square."""
    return [-(most + shift * size) for shift in _SHIFTS if most > 0.0]


def _kinks_within_range(u: FloatArray, size: float) -> Sequence[float]:
    """Return places of a kink in the range of u (R,)."""
    low, high = float(u.min()), float(u.max())
    return [low + share * (high - low) for share in _KINKS]


def _powers_of_shifts(exponent: int, size: float) -> Sequence[float]:
    """Return shifts for a power of a variable; `size` is the root mean square of the power."""
    return [shift**exponent * size for shift in _SHIFTS]


def _arguments(
    inputs: FloatArray, columns: Sequence[int], operators: set[int]
) -> Iterator[tuple[Expression, FloatArray, list[Function]]]:
    """Yield arguments, the values (R,) of each argument, and the functions that are tried with it."""

    def allowed(functions: dict[int, Function]) -> list[Function]:
        return [function for code, function in functions.items() if code in operators]

    waves = allowed(_WAVES)
    for column in columns:
        u, leaf = inputs[column], (VARIABLE, column)
        is_positive = bool((u > 0.0).all())
        positive = allowed(_OF_POSITIVE) if is_positive else []
        has_both_signs = bool(u.min() < 0.0 < u.max())
        kinked = [replace(_KINK, constants=partial(_kinks_within_range, u))] if ABS in operators else []
        kinked += [_ABS] if ABS in operators and has_both_signs else []
        kinked += [_SIGN] if {ABS, DIVIDE} <= operators and has_both_signs else []
        yield leaf, u, [*waves, *allowed(_OF_ANY), *([_OVER] if DIVIDE in operators else []), *positive, *kinked]
        yield (MULTIPLY, leaf, leaf), u * u, allowed(_OF_SQUARES)
        if is_positive and {EXP, DIVIDE} <= operators:
            yield (DIVIDE, 1.0, leaf), 1.0 / u, [_EXP]
        yield from _quotients(u, column) if DIVIDE in operators else ()
    for first, second in combinations(columns, 2):
        for join, u in ((SUBTRACT, inputs[first] - inputs[second]), (ADD, inputs[first] + inputs[second])):
            if join in operators:
                yield (join, (VARIABLE, first), (VARIABLE, second)), u, waves
