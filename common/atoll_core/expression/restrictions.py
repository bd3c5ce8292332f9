"""Users' conditions on an equation: bounds on its constants, and variables that it must contain.

A bound is a text such as ``c > 0`` (every constant), ``0 < c < 10``, ``|c| < 5`` (every magnitude), ``x*y < 0`` (the
coefficient of the term x*y) or ``inner > 0`` (the numbers inside terms). The constants are the constants of the
expanded equation (`atoll_core.expression.writing.expansion`), each with its sign: in ``3*x - 2*x*y`` they are 3 and -2.
A bound on a term has no effect on an equation without this term. Ranges include their ends: a constant may lie on its
bound.
"""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Final, Literal

import numpy as np

from atoll_core.config import JobConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from atoll_core.expression.program import Program, constant_places, structure, variables_of, with_constants
from atoll_core.expression.shapes import Shapes, read_shapes, shape_points
from atoll_core.expression.text.parsing import from_infix
from atoll_core.expression.writing.expansion import Role, Shape, expand_program, inner_numbers, shape_of, terms_of
from atoll_core.expression.writing.sums_of_products import ONE, UndefinedError

EVERY: Final = "c"
"""In a bound, this name means every constant, unless a variable has the same name."""
ALSO_EVERY: Final = "constants"
INNER: Final = "inner"
"""In a bound, this name means the numbers inside terms."""
ALL_EQUATIONS: Final = "*"
"""This text is used instead of the name of one equation, and means all equations."""
EXAMPLES: Final = "c > 0, 0 < c < 10, |c| < 5, x: x*y < 0 or inner > 0"
ROUNDING: Final = 1e-9
"""Relative tolerance of a bound, for the rounding errors of rewriting an equation."""

_FIRST: Final = 0.0101
_STEP: Final = 0.0007
"""Constants for `_roles_of`. No rule of rewriting treats these numbers specially; there are such rules for integers,
halves and multiples of pi/4."""

Scope = Literal["every", "inner", "term"]
_COMPARISON: Final = re.compile(r"<=|>=|<|>")
_SIZE: Final = re.compile(r"\|(.+)\|")


@dataclass(frozen=True)
class ConstantBound:
    """One bound: all numbers in its `scope` lie between `lower` and `upper`. If the bound is for one term, `shape` is
    the shape of this term."""

    text: str
    scope: Scope
    lower: float
    upper: float
    shape: Shape = None

    def covers(self, shape: Shape, *, is_inner: bool) -> bool:
        """Tell whether the bound applies to the coefficient of a term of this shape, or to the term's inner numbers."""
        if self.scope == "term":
            return not is_inner and shape == self.shape
        return self.scope == "every" or is_inner


def parse_bound(text: str, names: Sequence[str]) -> ConstantBound:
    """Return the bound of a text such as ``0 < c < 10``; `names` are the names of the variables.

    Raises:
        UsageError: the text is no bound, its range is empty, or it names a sum or an unknown variable.
    """
    parts = [part.strip() for part in _COMPARISON.split(text)]
    signs = _COMPARISON.findall(text)
    if len(signs) not in (1, 2) or not all(parts) or len({sign[0] for sign in signs}) != 1:
        raise UsageError(f"the bound {text!r} is not understood; write it as {EXAMPLES}")
    if "nan" in parts:
        _number("nan", text)
    if signs[0][0] == ">":
        parts.reverse()
    if len(parts) == 3:
        lower, subject, upper = _number(parts[0], text), parts[1], _number(parts[2], text)
    elif _is_number(parts[0]):
        lower, subject, upper = _number(parts[0], text), parts[1], math.inf
    else:
        lower, subject, upper = -math.inf, parts[0], _number(parts[1], text)
    size = _SIZE.fullmatch(subject)
    if size:
        if lower > 0.0 or not upper >= 0.0:
            raise UsageError(f"the bound {text!r} excludes numbers around zero; give only the largest one, as |c| < 5")
        subject, lower = size[1].strip(), -upper
    if not lower <= upper:
        raise UsageError(f"the bound {text!r} allows no number; give the smaller one first")
    return _bound(text, subject, lower, upper, names)


def _bound(text: str, subject: str, lower: float, upper: float, names: Sequence[str]) -> ConstantBound:
    if subject in (EVERY, ALSO_EVERY, INNER) and subject not in names:
        return ConstantBound(text, "inner" if subject == INNER else "every", lower, upper)
    try:
        terms = terms_of(from_infix(subject, names))
    except (UsageError, UndefinedError) as error:
        raise UsageError(f"the bound {text!r} names no term: {error or 'it has no value'}") from error
    if len(terms) != 1 or terms[0][0] == ONE:
        raise UsageError(f"the bound {text!r} is about {subject!r}, which is no single term; give one such as x*y")
    if terms[0][1] != 1.0:
        raise UsageError(f"the bound {text!r} has a number in its term; write the range instead, as x*y < 2")
    return ConstantBound(text, "term", lower, upper, shape_of(terms[0][0]))


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _number(text: str, whole: str) -> float:
    if not _is_number(text):
        raise UsageError(f"the bound {whole!r} has {text!r} where a number is expected; write it as {EXAMPLES}")
    return float(text)


@dataclass(frozen=True, eq=False)
class Governed:
    """A bound, and the numbers in an equation to which it applies. `is_active` tells whether one of these numbers lies
    on a limit of the bound."""

    bound: ConstantBound
    values: tuple[float, ...]
    is_active: bool


@dataclass(frozen=True, eq=False)
class EquationBounds:
    """All bounds on the constants of one equation. Programs are laid out so that each bound applies to one constant."""

    bounds: tuple[ConstantBound, ...]

    def range_of(self, shape: Shape, *, is_inner: bool) -> tuple[float, float]:
        """Return the smallest and the largest allowed number. If no number is allowed, the first returned number is
        larger than the second."""
        covering = [bound for bound in self.bounds if bound.covers(shape, is_inner=is_inner)]
        lower = max((bound.lower for bound in covering), default=-math.inf)
        return lower, min((bound.upper for bound in covering), default=math.inf)

    def laid_out(self, program: Program) -> Program | None:
        """Return `program` with brackets expanded. If a factor equal to 1 has a bound, it is written as a constant.
        None if this is impossible.

        A program that is already laid out is returned unchanged, for any values of its constants.
        """
        laid_out = program if self._roles_of(program) is not None else self.written(program)
        roles = None if laid_out is None else self._roles_of(laid_out)
        if roles is None or any(lower > upper for lower, upper in map(self._range_of_role, roles)):
            return None
        return laid_out

    def written(self, program: Program) -> Program | None:
        """Return `program` laid out again, with signs in the places where a reader expects them. None if this is
        impossible."""
        expansion = expand_program(program, self.is_written)
        return None if expansion is None else expansion.program

    def is_written(self, shape: Shape, value: float) -> bool:
        """Tell whether a coefficient equal to 1 or -1 must be a constant."""
        return not self._holds(shape, value, is_inner=False)

    def _roles_of(self, program: Program) -> tuple[Role, ...] | None:
        """Return the roles of the constants of a laid-out program; None for other programs.

        Whether a program is laid out depends only on its structure: when its constants are replaced by `_FIRST`,
        `_FIRST + _STEP`, ..., it must be equal to its own expansion.
        """
        numbers = {place: _FIRST + _STEP * number for number, place in enumerate(constant_places(program))}
        return _roles(self.bounds, with_constants(program, numbers))

    def _range_of_role(self, role: Role) -> tuple[float, float]:
        return self.range_of(role.shape, is_inner=role.is_inner)

    def ranges(self, program: Program) -> tuple[FloatArray, FloatArray] | None:
        """Return the smallest and largest values (K,) of the constants of a laid-out program; None for other
        programs."""
        roles = self._roles_of(program)
        if roles is None:
            return None
        pairs = [(role.sign, *self._range_of_role(role)) for role in roles]
        signed = [(lower, upper) if sign > 0.0 else (-upper, -lower) for sign, lower, upper in pairs]
        lowest, largest = np.array(signed, np.float64).reshape(len(signed), 2).T.copy()
        return lowest, largest

    def clipped(self, program: Program) -> Program:
        """Return a laid-out program with its constants clipped to their bounds."""
        ranges = self.ranges(program)
        if ranges is None:
            return program
        constants, places = program.constants.copy(), constant_places(program)
        constants[places] = np.clip(constants[places], *ranges)
        return replace(program, constants=constants)

    def are_kept(self, program: Program) -> bool:
        """Tell whether all constants of a program, in any layout, are within the bounds."""
        try:
            return all(self._holds(shape, value, is_inner=is_inner) for shape, value, is_inner in _numbers_of(program))
        except UndefinedError:
            return False

    def _holds(self, shape: Shape, value: float, *, is_inner: bool) -> bool:
        lower, upper = self.range_of(shape, is_inner=is_inner)
        return lower - ROUNDING * abs(lower) <= value <= upper + ROUNDING * abs(upper)

    def governed(self, program: Program) -> tuple[Governed, ...]:
        """Return each bound with the numbers of `program` to which the bound applies."""
        try:
            numbers = _numbers_of(program)
        except UndefinedError:
            return ()
        governed = []
        for bound in self.bounds:
            values = tuple(value for shape, value, is_inner in numbers if bound.covers(shape, is_inner=is_inner))
            ends = (bound.lower, bound.upper)
            is_active = any(
                math.isclose(value, end, rel_tol=ROUNDING, abs_tol=1e-300) for value in values for end in ends
            )
            governed.append(Governed(bound, values, is_active))
        return tuple(governed)


def _numbers_of(program: Program) -> list[tuple[Shape, float, bool]]:
    """Return each number with the shape of its term, and whether it is inside the term. Raises UndefinedError."""
    numbers: list[tuple[Shape, float, bool]] = []
    for monomial, coefficient in terms_of(program):
        shape = shape_of(monomial)
        numbers.append((shape, coefficient, False))
        numbers += [(shape, number, True) for number in inner_numbers(((monomial, coefficient),))]
    return numbers


@lru_cache(maxsize=8192)
def _roles(bounds: tuple[ConstantBound, ...], program: Program) -> tuple[Role, ...] | None:
    """Return the roles of the constants of a program that is equal to its own expansion. None for other programs."""
    expansion = expand_program(program, EquationBounds(bounds).is_written)
    return expansion.roles if expansion is not None and structure(expansion.program) == structure(program) else None


def equation_bounds(texts: Mapping[str, Sequence[str]], variable: str, names: Sequence[str]) -> EquationBounds | None:
    """Return the bounds on the equation of `variable`; None if there are no bounds.

    `texts` are valid bounds by equation; a bound on all equations is repeated for each equation. `names` are the
    variables that the equation may use. A bound has no effect if its term has another variable.
    """
    bounds = []
    for text in texts.get(variable, ()):
        with suppress(UsageError):
            bounds.append(parse_bound(text, names))
    return EquationBounds(tuple(bounds)) if bounds else None


@dataclass(frozen=True, eq=False)
class Restrictions:
    """The conditions on one equation. `bounds` are the bounds on its constants; None: there are no bounds. `required`
    are the indices of the variables that it must contain. It must have the `shapes` at the points (V, G); None: shapes
    are not demanded, or not tested."""

    bounds: EquationBounds | None = None
    required: frozenset[int] = frozenset()
    shapes: Shapes = field(default_factory=Shapes)
    points: FloatArray | None = None

    @property
    def are_none(self) -> bool:
        """Whether there are no restrictions, so that every program satisfies them."""
        return self.bounds is None and not self.required and self.points is None

    def admitted(self, program: Program) -> Program | None:
        """Return `program` laid out for a fit within the bounds. None if the program is not allowed."""
        if not self.has_required(program):
            return None
        return program if self.bounds is None else self.bounds.laid_out(program)

    def are_kept(self, program: Program) -> bool:
        """Tell whether a program with its present constants satisfies all restrictions."""
        return (
            self.has_required(program)
            and (self.bounds is None or self.bounds.are_kept(program))
            and self.has_shapes(program)
        )

    def has_shapes(self, program: Program) -> bool:
        """Tell whether a program with its present constants has the demanded shapes."""
        return self.points is None or self.shapes.are_kept(program, self.points)

    def ranges(self, program: Program, fixed: Collection[int] = ()) -> FloatArray:
        """Return the smallest and the largest values (2, K) of the constants of an admitted program. They are infinite
        if there are no bounds.

        Constants at the nodes `fixed` are left out.
        """
        places = constant_places(program)
        found = None if self.bounds is None else self.bounds.ranges(program)
        ranges = np.repeat([[-np.inf], [np.inf]], len(places), axis=1) if found is None else np.array(found)
        return ranges[:, np.array([place not in fixed for place in places], np.bool_)]

    def has_required(self, program: Program) -> bool:
        """Tell whether `program` contains all required variables."""
        return self.required <= variables_of(program)


NONE = Restrictions()


def restrictions_of(
    config: JobConfig, variable: str, names: Sequence[str], inputs: FloatArray | None = None
) -> Restrictions:
    """Return the restrictions of the equation of `variable`, which may use the variables of these symbols.

    Shapes are tested at the rows `inputs` (V, R) and between them; None: they are not tested.
    """
    required = frozenset(map(names.index, config.space.required_of.get(variable, ())))
    bounds = equation_bounds(config.prior.bounds, variable, names)
    shapes = equation_shapes(config.prior.shapes_of(variable), names)
    points = None if inputs is None or shapes == Shapes() else shape_points(inputs)
    return Restrictions(bounds, required, shapes, points)


def equation_shapes(texts: Sequence[str], names: Sequence[str]) -> Shapes:
    """Return the shapes of these valid texts. A shape has no effect if its variable is not among the `names` that the
    equation may use."""
    shapes = Shapes()
    for text in texts:
        with suppress(UsageError):
            shapes = shapes.with_all(read_shapes([text], names, "a shape"))
    return shapes
