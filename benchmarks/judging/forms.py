"""Is a model exact in form? The checker behind every claim that an equation was found.

``python -m benchmarks.judging.forms MODEL TRUTH [--data FILE.csv]``

Model and truth are written as fractions of polynomials (`benchmarks.judging.rewriting`). Terms that contribute less
than `NEGLIGIBLE` of the target's standard deviation on the data are dropped. The model is exact in form when it equals,
within the same `NEGLIGIBLE` per term, a fraction with the truth's monomials and no others, whose coefficients, after
dividing by one that the truth has, all lie within the tolerance of the truth's.

A model may have a polynomial factor in numerator and denominator that cancels, as a sum of two fractions has. So the
fraction N'/D' with the truth's monomials is sought that makes N D' - D N' vanish, N/D being the model: a linear problem
in the coefficients of N' and D'. Its residual must be negligible monomial by monomial, not only in sum over the data:
a model that merely approximates the truth does not pass. A factor that cancels only nearly leaves a residual, too.
Constants inside sin, cos and other functions are coefficients like all others: they may differ by the tolerance.
The truth must be written in lowest terms.
"""

import csv
import math
import re
import sys
from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from atoll_core.errors import UsageError
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.text.parsing import from_infix
from benchmarks.harness.command_line import option, program
from benchmarks.judging.fractions import (
    Atoms,
    FloatArray,
    Fraction,
    Monomial,
    Polynomial,
    TooLargeError,
    UndefinedError,
)
from benchmarks.judging.rewriting import Rewritten, rewrite
from benchmarks.judging.rules import NO_EQUATION, Form, Kind

NEGLIGIBLE: Final = 1e-6
"""Share of the target's standard deviation below which a term counts as absent."""

FRESH_POINTS: Final = 1_000
SLACK: Final = 3.0
"""How often the effect of a small change of the truth's angles the same change of the model's angles may have."""


class _DifferentError(Exception):
    """Raised with the sentence that says why the forms differ."""

    kind: Kind = "other"


class _MissingError(_DifferentError):
    """Raised where a term of the truth is missing."""

    kind = "missing"


def compare(
    model: str | None, truth: str, data: Mapping[str, FloatArray], target_sd: float, tolerance: float = 0.01
) -> Form:
    """Compare `model` with `truth`, both infix text over the names of `data`.

    Args:
        model: the expression that was found, None where there is none.
        truth: the expression sought, in lowest terms.
        data: the rows on which contributions are measured: by name, R values each.
        target_sd: standard deviation of the target, in its units.
        tolerance: largest relative difference of a coefficient.

    Raises:
        UsageError: one of the texts is no expression over `data`'s names.
    """
    if model is None:
        return NO_EQUATION
    with np.errstate(all="ignore"):
        function_error = _function_error(model, truth, data)
        try:
            difference = _constants_error(model, truth, data, target_sd, tolerance)
        except _DifferentError as different:
            return Form(different.kind, reason=str(different), function_error=function_error)
        except TooLargeError:
            return Form("other", reason="too many terms to compare", function_error=function_error)
        except UndefinedError:
            return Form("other", reason="a division by zero", function_error=function_error)
    is_within = difference <= tolerance
    reason = "the same form" if is_within else f"a constant differs by {difference:.3g}"
    return Form("right" if is_within else "near", None, reason, difference, function_error)


def _constants_error(
    model: str, truth: str, data: Mapping[str, FloatArray], target_sd: float, tolerance: float
) -> float:
    """Return the largest relative difference of a coefficient; raises _DifferentError."""
    both = rewrite(truth, model, data, tolerance)
    scale = _Scale(both.atoms, target_sd)
    sought, found = scale.without_negligible(both.truth), scale.without_negligible(both.model)
    if not sought.numerator:
        raise _DifferentError("the truth is zero")
    if not found.numerator:
        raise _MissingError("a term is missing: everything")
    _check_arguments(model, data, both, found, scale)
    if not _has_same_monomials(found, sought):
        found = _in_form_of(sought, found, scale)
    return max(_largest_difference(found, sought, scale), both.angle_difference, both.argument_difference)


class _Scale:
    """Measures how much a term contributes on the data, as root mean square over the target's deviation."""

    def __init__(self, atoms: Atoms, target_sd: float) -> None:
        self.atoms = atoms
        self._target_sd = target_sd

    def values(self, fraction: Fraction) -> FloatArray:
        return self.atoms.evaluate(fraction.numerator) / self.atoms.evaluate(fraction.denominator)

    def contribution(self, values: FloatArray) -> float:
        finite = values[np.isfinite(values)]
        return float(np.sqrt(np.mean(finite**2))) / self._target_sd if len(finite) else math.inf

    def contributions(self, polynomial: Polynomial, factor: FloatArray) -> Polynomial:
        return {
            monomial: self.contribution(coefficient * self.atoms.value(monomial) * factor)
            for monomial, coefficient in polynomial.items()
        }

    def sensitivity(self, fraction: Fraction, difference: float) -> float:
        """Return what a relative `difference` of each base angle contributes, summed over the angles."""
        before = self.values(fraction)
        total = 0.0
        for number in self.atoms.scalable:
            self.atoms.scale_argument(number, 1.0 + difference)
            total += self.contribution(self.values(fraction) - before)
            self.atoms.scale_argument(number, 1.0)
        return total

    def without_negligible(self, fraction: Fraction) -> Fraction:
        below = 1.0 / self.atoms.evaluate(fraction.denominator)
        above = self._kept(fraction.numerator, below)
        return Fraction(above, self._kept(fraction.denominator, self.values(fraction) * below))

    def _kept(self, polynomial: Polynomial, factor: FloatArray) -> Polynomial:
        sizes = self.contributions(polynomial, factor)
        return {monomial: value for monomial, value in polynomial.items() if sizes[monomial] >= NEGLIGIBLE}


def _check_arguments(
    model: str, data: Mapping[str, FloatArray], both: Rewritten, found: Fraction, scale: _Scale
) -> None:
    """Refuse a model whose angles or other arguments differ from the truth's by little, but to great effect.

    A difference of two sines of nearly equal angles vanishes when both are taken for the same angle.
    """
    if max(both.angle_difference, both.argument_difference) <= NEGLIGIBLE:
        return
    actual = values_of(from_infix(model, tuple(data)), np.array([*data.values()]))
    error = scale.contribution(actual - scale.values(found))
    allowed = SLACK * (scale.sensitivity(found, both.angle_difference) + both.argument_difference) + NEGLIGIBLE
    if not error <= allowed:
        raise _DifferentError(f"arguments differ from the truth's, by {error:.3g} of the target's deviation")


def _has_same_monomials(left: Fraction, right: Fraction) -> bool:
    return left.numerator.keys() == right.numerator.keys() and left.denominator.keys() == right.denominator.keys()


def _in_form_of(form: Fraction, model: Fraction, scale: _Scale) -> Fraction:
    """Return the fraction with the monomials of `form` that equals `model`; raises _DifferentError if there is none."""
    above, below = sorted(form.numerator), sorted(form.denominator)
    products = [scale.atoms.multiply(model.numerator, {monomial: 1.0}) for monomial in below]
    products += [scale.atoms.multiply(model.denominator, {monomial: -1.0}) for monomial in above]
    monomials = sorted({monomial for product in products for monomial in product})
    size = 1.0 / (scale.atoms.evaluate(model.denominator) * scale.atoms.evaluate(form.denominator))
    weights = scale.contributions(dict.fromkeys(monomials, 1.0), size)
    matrix = np.array([[weights[row] * product.get(row, 0.0) for product in products] for row in monomials])
    solution = _null_vector(matrix)
    found = Fraction(
        dict(zip(above, solution[len(below) :], strict=True)), dict(zip(below, solution[: len(below)], strict=True))
    )
    _check_residual(matrix @ solution, monomials, _normalizer(found, form, scale), scale.atoms)
    return found


def _null_vector(matrix: FloatArray) -> list[float]:
    """Return the vector of length one in scaled columns that `matrix` makes smallest."""
    lengths = np.sqrt((matrix**2).sum(axis=0))
    if not np.isfinite(lengths).all() or not lengths.all():
        raise _DifferentError("terms that are not finite on the data")
    columns = matrix / lengths
    square = np.vstack([columns, np.zeros((max(0, columns.shape[1] - columns.shape[0]), columns.shape[1]))])
    _, _, directions = np.linalg.svd(square, full_matrices=False)
    return [float(value) for value in directions[-1] / lengths]


def _check_residual(residual: FloatArray, monomials: Sequence[Monomial], normalizer: float, atoms: Atoms) -> None:
    """Refuse when a monomial is left over that contributes."""
    worst = int(np.argmax(np.abs(residual)))
    left = abs(float(residual[worst])) * abs(normalizer)
    if not left < NEGLIGIBLE:
        name = atoms.text(monomials[worst])
        raise _DifferentError(f"not the truth's terms: {name} is left over, {left:.3g} of the target's deviation")


def _normalizer(found: Fraction, form: Fraction, scale: _Scale) -> float:
    """Return the factor that makes the largest coefficient of the denominator equal to that of `form`."""
    size = scale.contributions(form.denominator, np.ones(scale.atoms.rows))
    pivot = max(sorted(size), key=lambda monomial: size[monomial])
    value = found.denominator.get(pivot, 0.0)
    return form.denominator[pivot] / value if value else math.inf


def _largest_difference(found: Fraction, sought: Fraction, scale: _Scale) -> float:
    factor = _normalizer(found, sought, scale)
    largest = 0.0
    for part, whole in ((found.numerator, sought.numerator), (found.denominator, sought.denominator)):
        for monomial, coefficient in whole.items():
            relative = factor * part.get(monomial, 0.0) / coefficient
            if not abs(relative) > NEGLIGIBLE:
                raise _MissingError(f"a term is missing: {scale.atoms.text(monomial)}")
            largest = max(largest, abs(relative - 1.0))
    return largest


def _function_error(model: str, truth: str, data: Mapping[str, FloatArray]) -> float | None:
    """Return the difference on fresh points, drawn uniformly from the range of each column."""
    generator = np.random.default_rng(0)
    fresh = np.array([generator.uniform(np.min(column), np.max(column), FRESH_POINTS) for column in data.values()])
    found, sought = (values_of(from_infix(text, tuple(data)), fresh) for text in (model, truth))
    defined = np.isfinite(sought)
    error = (
        float(np.sqrt(np.mean((found - sought)[defined] ** 2)) / np.std(sought[defined])) if defined.any() else math.nan
    )
    return error if math.isfinite(error) else None


def _shown(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _read(file: Path) -> dict[str, FloatArray]:
    with file.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def _uniform(*texts: str) -> dict[str, FloatArray]:
    generator = np.random.default_rng(1)
    names = dict.fromkeys(name for text in texts for name in re.findall(r"[^\W\d]\w*(?!\w*\s*\()", text))
    return {name: generator.uniform(0.5, 2.5, 200) for name in names if name != "pi"}


@program(
    "benchmarks.judging.forms",
    __doc__,
    option("model"),
    option("truth"),
    option("--data", type=Path, help="CSV with the variables as columns; default: uniform on [0.5, 2.5]"),
    option("--deviation", type=float, help="standard deviation of the target; default: the truth's"),
    option("--tolerance", type=float, default=0.01, help="relative, for each coefficient (0.01)"),
    description="Is a model exact in form?",
)
def main(options: Namespace) -> int:
    """Compare two expressions on the command line; exit code 0 when they have the same form, else 1."""
    data = _read(options.data) if options.data else _uniform(options.model, options.truth)
    try:
        deviation = options.deviation or float(
            np.std(values_of(from_infix(options.truth, tuple(data)), np.array([*data.values()])))
        )
        verdict = compare(options.model, options.truth, data, deviation, options.tolerance)
    except UsageError as error:
        print(error, file=sys.stderr)
        return 2
    print(f"{'exact in form' if verdict.is_right else 'not exact in form'}: {verdict.reason}")
    print(f"largest difference of a constant: {_shown(verdict.constants_error)}")
    print(f"error on fresh points: {_shown(verdict.function_error)}")
    return 0 if verdict.is_right else 1


if __name__ == "__main__":
    sys.exit(main())
