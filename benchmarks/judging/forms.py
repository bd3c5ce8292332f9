"""Has an equation the form of the truth? Decided by fitting: is there a choice of constants that makes them equal?

Every number of the truth and every coefficient of one that is not written gets a factor. An equation has the truth's
form when some positive factors make the truth equal to it, to a millionth of the derivative's deviation, on the
measured states without errors and on points of the box around them: whatever the dress, and with constants as errors
leave them.

`compare` asks whether it is exact in form: no factor is farther from 1 than a tolerance, and it is no approximation. An
approximation goes another way beyond the box, as polynomials do that stand for a sine and crumbs of a high degree, or
has functions that are hardly bent on it, as sines of small angles that stand for their angles.

`judge_form` takes any constants, and counts what is too much: parts of little effect without which the form is still
right are extra terms. When the form is not the truth's, the equation is written as a sum of products, and the
smallest summands are left out one after the other: an equation that has the form then had so many extra terms.
"""

import ast
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
from scipy.linalg import qr
from scipy.optimize import least_squares

from atoll_core.data.dataset import FloatArray
from benchmarks.judging.errors import error_on, values_on
from benchmarks.judging.rules import NO_EQUATION, Form, Kind

NEGLIGIBLE: Final = 1e-6
"""Largest difference, over the derivative's deviation, between two writings of one function."""

LITTLE: Final = 1e-3
"""Largest effect, over the derivative's deviation, of a part that the truth's constants can take over: a crumb."""

VANISHED: Final = 1e-3
"""A factor below this: the term is missing."""

MOST_EXTRA: Final = 10
MOST_SUMMANDS: Final = 60
POINTS: Final = 150
"""Rows among the measured ones, and as many in the box."""

LEAST_FINITE: Final = 0.5
FRESH_POINTS: Final = 1_000
FAR: Final = 30.0
"""Half widths of the box that far points lie from its middle, at most. There, too, right equations differ by less than
`NEGLIGIBLE`: the 238 of Table III and the label files by 8e-9 at most."""

FLAT: Final = 0.025
"""A function whose argument varies by less on the box may pass for its tangent or parabola, by `NEGLIGIBLE`: a sine up
to 0.014, a cosine up to 0.020."""

_REDUNDANT: Final = 1e-8
"""Numerics: singular values below this share of the largest are those of factors that can stand in for one another."""

_FAR: Final = 1e150
_FUNCTIONS: Final[dict[str, Any]] = {
    "sin": np.sin, "cos": np.cos, "exp": np.exp, "log": np.log, "sqrt": np.sqrt, "abs": np.abs, "tanh": np.tanh,
    "tan": np.tan, "cot": lambda value: 1.0 / np.tan(value), "inv": lambda value: 1.0 / value,
    "square": lambda value: value * value, "pow": np.power, "inverse": lambda value: 1.0 / value,
}  # fmt: skip


_REASONS: Final[Mapping[Kind, str]] = {
    "right": "the same form",
    "missing": "a term is missing",
    "other": "no constants make the truth equal to it",
}


_APPROXIMATE: Final = "it only approximates the truth"


def compare(text: str | None, truth: str, columns: Mapping[str, FloatArray], tolerance: float = 0.01) -> Form:
    """Tell whether `text` is exact in form: the truth with constants that differ by at most a relative `tolerance`.

    Both are infix text over the names of `columns`, (R,) values without errors; raises UsageError where one is none.
    """
    if text is None:
        return NO_EQUATION
    with np.errstate(all="ignore"):
        function_error = _function_error(text, truth, columns)
        points = _points(columns)
        model = _Model(truth, points)
        try:
            tree = _parsed(text)
            kind = model.match(_evaluated(tree, points))
            is_flat = _flat_calls(tree, points) > _flat_calls(_parsed(truth), points)
            if kind == "right" and (is_flat or not model.agrees(tree, _far_points(columns))):
                return Form("other", reason=_APPROXIMATE, function_error=function_error)
            difference = model.largest_difference() if kind == "right" else 0.0
        except (SyntaxError, RecursionError, ValueError, TypeError, MemoryError, OverflowError, ZeroDivisionError):
            kind = "other"
        if kind != "right":
            return Form(kind, reason=_REASONS[kind], function_error=function_error)
    is_within = difference <= tolerance
    reason = _REASONS["right"] if is_within else f"a constant differs by {difference:.3g}"
    return Form("right" if is_within else "near", None, reason, difference, function_error)


def judge_form(text: str | None, truth: str, columns: Mapping[str, FloatArray], *, with_extra: bool = True) -> Form:
    """Compare the form of `text` with that of `truth`, both over the names of `columns`, (R,) values without errors.

    Without `with_extra`, extra terms are not looked for.
    """
    if text is None:
        return NO_EQUATION
    points = _points(columns)
    with np.errstate(all="ignore"):
        model = _Model(truth, points)
        try:
            values = _evaluated(_parsed(text), points)
            kind = model.match(values)
            if kind == "right":
                needless = _needless(model, _parsed(text), points)
                return Form("extra" if needless else "right", needless)
            extra = None if not with_extra else _extra(model, _parsed(text), points)
        except (SyntaxError, RecursionError, ValueError, KeyError, TypeError, MemoryError):
            return Form("other")
    return Form(kind) if extra is None else Form("extra", extra)


def _extra(model: "_Model", tree: ast.expr, points: Mapping[str, FloatArray]) -> int | None:
    """Return the number of smallest summands without which the form is right; None when there is none."""
    summands = _merged([_evaluated(summand, points) for summand in _expanded(tree)][:MOST_SUMMANDS])
    summands.sort(key=lambda summand: -model.size(summand))
    for left_out in range(1, min(MOST_EXTRA, len(summands) - 1) + 1):
        if model.match(sum(summands[: len(summands) - left_out], np.zeros(1))) == "right":
            return left_out
    return None


def _needless(model: "_Model", tree: ast.expr, points: Mapping[str, FloatArray]) -> int:
    """Return how many summands and factors can be left out, one after the other, with little effect."""
    count = 0
    values = _evaluated(tree, points)
    while True:
        for shorter in _shorter(tree):
            if model.has_little_effect(values, _evaluated(shorter, points)):
                tree, count = shorter, count + 1
                break
        else:
            return count


def _shorter(node: ast.expr) -> Iterator[ast.expr]:
    """Yield `node` with one operand of a sum or product left out, the outermost first; numeric factors stay."""
    match node:
        case ast.BinOp(left, operator, right):
            if isinstance(operator, ast.Add | ast.Sub):
                yield left
                yield right if isinstance(operator, ast.Add) else ast.UnaryOp(ast.USub(), right)
            elif isinstance(operator, ast.Mult | ast.Div):
                yield from [left] if not _is_number(right) else []
                yield from [right] if isinstance(operator, ast.Mult) and not _is_number(left) else []
            yield from (ast.BinOp(shorter, operator, right) for shorter in _shorter(left))
            yield from (ast.BinOp(left, operator, shorter) for shorter in _shorter(right))
        case ast.UnaryOp(operator, operand):
            yield from (ast.UnaryOp(operator, shorter) for shorter in _shorter(operand))
        case ast.Call(function, [argument]):
            yield from (ast.Call(function, [shorter], []) for shorter in _shorter(argument))


def _is_number(node: ast.expr) -> bool:
    return isinstance(node.operand if isinstance(node, ast.UnaryOp) else node, ast.Constant)


class _Model:
    """The truth with a factor at every number, and at every summand."""

    def __init__(self, truth: str, points: Mapping[str, FloatArray]) -> None:
        names: list[str] = []
        tree = ast.fix_missing_locations(_with_factors(_parsed(truth), names))
        self._names = names
        self._run = _compiled(tree)
        self._points = points
        target = self._values(np.ones(len(names)))
        self._kept = np.isfinite(target)
        self._scale = float(np.std(target[self._kept])) or 1.0
        self._weight = 1.0 / (self._scale + np.abs(target))
        self._factors = np.ones(len(names))
        self._jacobian = np.zeros((0, len(names)))

    def has_little_effect(self, before: FloatArray, after: FloatArray) -> bool:
        """Tell whether a change of values is small, and leaves the form right."""
        if not (np.isfinite(after) >= np.isfinite(before)).all():
            return False
        change = self.size(after - before) / self._scale
        return change <= NEGLIGIBLE or (change <= LITTLE and self.match(after) == "right")

    def size(self, values: FloatArray) -> float:
        """Return the root mean square of some values, as far as they are finite."""
        finite = np.broadcast_to(values, self._kept.shape)
        finite = finite[np.isfinite(finite)]
        return float(np.sqrt((finite**2).mean())) if len(finite) else np.inf

    def match(self, values: FloatArray) -> Kind:
        """Say whether factors make the truth equal to `values`: all of them positive, or some zero, or not at all."""
        values = np.broadcast_to(values, self._kept.shape)
        kept = self._kept & np.isfinite(values)
        if not kept.sum() > LEAST_FINITE * self._kept.sum():
            return "other"

        def residuals(factors: FloatArray) -> FloatArray:
            left = ((self._values(factors) - values) * self._weight)[kept]
            return np.nan_to_num(left, nan=_FAR, posinf=_FAR, neginf=-_FAR).clip(-_FAR, _FAR)

        start = np.ones(len(self._names))
        if not np.abs(residuals(start)).max() < _FAR:
            return "other"
        try:
            fit = least_squares(residuals, start, "3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=200)
        except (ValueError, np.linalg.LinAlgError):
            return "other"
        if not float(np.sqrt((fit.fun**2).mean())) <= NEGLIGIBLE:
            return "other"
        self._factors, self._jacobian = fit.x, fit.jac
        return "right" if (fit.x > VANISHED).all() else "missing"

    def agrees(self, tree: ast.expr, points: Mapping[str, FloatArray]) -> bool:
        """Tell whether the truth with the factors of the last match has the values of an equation at other points."""
        sought = self._run({**points, **dict(zip(self._names, self._factors.tolist(), strict=True))})
        sought, values = np.broadcast_arrays(sought, np.atleast_1d(_evaluated(tree, points)))
        scale = self._scale + np.abs(sought)
        seen = np.isfinite(scale) & np.isfinite(values)
        return bool((np.abs(values - sought)[seen] <= NEGLIGIBLE * scale[seen]).all())

    def largest_difference(self) -> float:
        """Return the largest difference from 1 of the factors that the last match, which was right, has found.

        Of factors that can stand in for one another, as those of a numerator and its denominator, that of the largest
        effect is taken as 1.
        """
        logarithms, effects = np.log(self._factors), self._jacobian * self._factors
        _, sizes, directions = np.linalg.svd(effects, full_matrices=False)
        redundant = directions[sizes <= _REDUNDANT * sizes.max(initial=0.0)]
        if len(redundant):
            _, _, order = qr(redundant * np.linalg.norm(effects, axis=0), mode="economic", pivoting=True)
            ones = order[: len(redundant)]
            logarithms = logarithms - redundant.T @ np.linalg.lstsq(redundant[:, ones].T, logarithms[ones])[0]
        return float(np.abs(np.expm1(logarithms)).max(initial=0.0))

    def _values(self, factors: FloatArray) -> FloatArray:
        values = self._run({**self._points, **dict(zip(self._names, factors.tolist(), strict=True))})
        return np.broadcast_to(np.asarray(values, dtype=np.float64), next(iter(self._points.values())).shape)


def _points(columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return rows of `columns`, evenly chosen, and random points of the box around all."""
    rng = np.random.default_rng(0)
    rows = np.linspace(0, len(next(iter(columns.values()))) - 1, POINTS).round().astype(np.int64)
    return {
        name: np.concatenate([values[rows], rng.uniform(values.min(), values.max(), POINTS)])
        for name, values in columns.items()
    }


def _flat_calls(tree: ast.expr, points: Mapping[str, FloatArray]) -> int:
    """Return the number of functions whose argument varies, but hardly."""
    calls = [node.args[0] for node in ast.walk(tree) if isinstance(node, ast.Call) and node.args]
    spans = [float(np.ptp(values[np.isfinite(values)])) for values in (_evaluated(call, points) for call in calls)]
    return sum(0.0 < span < FLAT for span in spans)


def _far_points(columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return random points of the box around all rows, made `FAR` times as wide."""
    rng = np.random.default_rng(1)
    middles = {name: (0.5 * (values.min() + values.max()), 0.5 * np.ptp(values)) for name, values in columns.items()}
    return {name: middle + FAR * half * rng.uniform(-1.0, 1.0, POINTS) for name, (middle, half) in middles.items()}


def _parsed(text: str) -> ast.expr:
    return ast.parse(text.replace("^", "**"), mode="eval").body


def _compiled(tree: ast.expr) -> Callable[[Mapping[str, Any]], Any]:
    code = compile(ast.Expression(tree), "equation", "eval")
    space = {"__builtins__": {}, "pi": np.pi, **_FUNCTIONS}
    return lambda values: eval(code, space, dict(values))  # of numbers, names, operators and the functions above


def _evaluated(tree: ast.expr, points: Mapping[str, FloatArray]) -> FloatArray:
    values = np.asarray(_compiled(ast.fix_missing_locations(tree))(points), dtype=np.float64)
    return np.broadcast_to(values, next(iter(points.values())).shape)


def _with_factors(node: ast.expr, names: list[str], *, is_summand: bool = True) -> ast.expr:
    """Return `node` with a factor at each number but whole exponents, and at each summand that has no number."""
    match node:
        case ast.BinOp(left, ast.Add() | ast.Sub() as operator, right):
            return ast.BinOp(_with_factors(left, names), operator, _with_factors(right, names))
        case ast.UnaryOp(operator, operand):
            return ast.UnaryOp(operator, _with_factors(operand, names, is_summand=is_summand))
        case ast.Constant():
            return _times_factor(node, names)
    inner = _with_factors_inside(node, names)
    return inner if not is_summand or _has_number(node) else _times_factor(inner, names)


def _with_factors_inside(node: ast.expr, names: list[str]) -> ast.expr:
    match node:
        case ast.BinOp(left, ast.Pow(), ast.Constant(int())):
            return ast.BinOp(_with_factors(left, names, is_summand=False), ast.Pow(), node.right)
        case ast.BinOp(left, operator, right):
            return ast.BinOp(
                _with_factors(left, names, is_summand=False), operator, _with_factors(right, names, is_summand=False)
            )
        case ast.Call(function, arguments):
            return ast.Call(function, [_with_factors(argument, names) for argument in arguments], [])
    return node


def _has_number(node: ast.expr) -> bool:
    """Tell whether a product has a number among its factors, which then has a factor of its own."""
    match node:
        case ast.Constant():
            return True
        case ast.UnaryOp(_, operand):
            return _has_number(operand)
        case ast.BinOp(left, ast.Mult() | ast.Div(), right):
            return _has_number(left) or _has_number(right)
    return False


def _times_factor(node: ast.expr, names: list[str]) -> ast.expr:
    names.append(f"factor_{len(names)}_")
    return ast.BinOp(ast.Name(names[-1], ast.Load()), ast.Mult(), node)


def _expanded(node: ast.expr) -> Iterator[ast.expr]:
    """Yield the summands of `node`, products and whole powers of sums multiplied out."""
    match node:
        case ast.BinOp(left, ast.Add(), right):
            yield from _expanded(left)
            yield from _expanded(right)
        case ast.BinOp(left, ast.Sub(), right):
            yield from _expanded(left)
            yield from (ast.UnaryOp(ast.USub(), summand) for summand in _expanded(right))
        case ast.UnaryOp(ast.USub(), operand):
            yield from (ast.UnaryOp(ast.USub(), summand) for summand in _expanded(operand))
        case ast.BinOp(left, ast.Mult(), right):
            yield from _products([*_expanded(left)], [*_expanded(right)])
        case ast.BinOp(left, ast.Div(), right):
            yield from (ast.BinOp(summand, ast.Div(), right) for summand in _expanded(left))
        case ast.BinOp(left, ast.Pow(), ast.Constant(int(times))) if 1 < times <= 4:
            parts = [*_expanded(left)]
            total = parts
            for _ in range(times - 1):
                total = [*_products(total, parts)]
            yield from total
        case _:
            yield node


def _products(left: Sequence[ast.expr], right: Sequence[ast.expr]) -> Iterator[ast.expr]:
    for one in left:
        for other in right:
            yield ast.BinOp(one, ast.Mult(), other)


def _merged(summands: Sequence[FloatArray]) -> list[FloatArray]:
    """Add up summands that are multiples of one another."""
    merged: list[FloatArray] = []
    for values in summands:
        for place, other in enumerate(merged):
            if _is_multiple(values, other):
                merged[place] = other + values
                break
        else:
            merged.append(values)
    return merged


def _is_multiple(left: FloatArray, right: FloatArray) -> bool:
    kept = np.isfinite(left) & np.isfinite(right)
    norms = float(np.linalg.norm(left[kept]) * np.linalg.norm(right[kept]))
    return norms > 0.0 and abs(float(left[kept] @ right[kept])) >= (1.0 - 1e-12) * norms


def _function_error(text: str, truth: str, columns: Mapping[str, FloatArray]) -> float | None:
    """Return the root mean square difference over the truth's deviation, on fresh points of the range of each column.

    None where it is not finite.
    """
    generator = np.random.default_rng(0)
    fresh = {name: generator.uniform(values.min(), values.max(), FRESH_POINTS) for name, values in columns.items()}
    values_on(text, fresh)  # raises UsageError, which `error_on` takes for no error
    defined = np.isfinite(values_on(truth, fresh))
    return error_on(text, truth, {name: values[defined] for name, values in fresh.items()}) if defined.any() else None
