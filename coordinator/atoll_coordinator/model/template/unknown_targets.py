"""Targets of unknown parts: what the derivatives say about the unknown parts of a template. Pure.

How it works. A side ``-c*v + k*?`` with the derivative on its left is solved for the unknown: ``(derivative +
c*v)/k``. These values on all rows are the target of the search, and their uncertainty is the uncertainty of the
derivative divided by the slope of the side by the unknown. If an unknown occurs in several equations, the mean of their
values is the target, weighted by inverse variances. Rows on which the slope is so small that they add more error than
information are left out. The parameters have the values of `parameter_estimates`.

Doubtful: the target of an unknown beside free parameters has an error that its uncertainty does not contain; refining
fits parameters and the unknown together, along the trajectories.

Letters: R rows, V variables, P parameters, U unknowns.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from atoll_coordinator.data.differentiation.kernels.stencils import moments
from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.data.templates import template_of
from atoll_coordinator.model.template.parameter_estimates import ParameterEstimates, estimate_parameters
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import JobConfig
from atoll_core.data.dataset import CLEAN_UNCERTAINTY, Dataset, FloatArray, IntArray, Target
from atoll_core.errors import DataError, UsageError
from atoll_core.expression.derivative import derivative
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.template import EquationTemplate

_CONTRADICTION: Final = 5.0
"""Median difference of the values of an unknown part by two equations, over its uncertainty, that is reported. The
uncertainty of a derivative is known up to a factor of two or so."""


def with_unknown_targets(preparation: Preparation, config: JobConfig) -> Preparation:
    """Return the preparation in which the targets of equations with an unknown part are the values of this part, and
    with estimates of the parameters.

    The preparation itself is returned for a job without a template. `config` is resolved.

    Raises:
        UsageError: a side cannot be solved for its unknown part.
        DataError: too few rows tell anything about an unknown part.
    """
    template = template_of(config, preparation.dataset.names)
    if not template.sides or preparation.recording is None:
        return preparation
    dataset = preparation.dataset
    estimates = ParameterEstimates(np.array(preparation.parameters))  # by hidden states, if there are any
    if not preparation.recording.hidden:
        estimates = estimate_parameters(dataset, config, template)
        preparation = replace(preparation, parameters=tuple(estimates.values.tolist()))
    if not template.unknowns:
        return preparation
    unknowns = _solve(template, dataset, estimates.values)
    rows = _useful_rows(list(unknowns.values()))
    if len(rows) < SETTINGS.common.fewest_rows:
        labels = ", ".join(unknown.label for unknown in template.unknowns)
        told = "1 row tells" if len(rows) == 1 else f"{len(rows)} rows tell"
        raise DataError(
            f"only {told} anything about the unknown part {labels}; sample more of them, or write the unknown part "
            "where its factor is not near 0"
        )
    warnings = (*dataset.warnings, *estimates.warnings, *_compare_equations(template, unknowns))
    targets = tuple(
        _unknown_target(target, unknowns[target.variable], rows, is_exact=not template.parameters_in(target.variable))
        if target.variable in unknowns
        else replace(target, values=np.ascontiguousarray(target.values[rows]))
        for target in dataset.targets
    )
    groups = None if dataset.groups is None else np.ascontiguousarray(dataset.groups[rows])
    inputs = np.ascontiguousarray(dataset.inputs[:, rows])
    changed = replace(dataset, inputs=inputs, targets=targets, warnings=warnings, groups=groups)
    held_out = preparation.held_out
    if held_out is not None:
        there = _solve(template, held_out, estimates.values)
        scaled = {target.variable: target for target in targets}
        held_out = replace(held_out, targets=tuple(
            replace(scaled[target.variable], values=there[target.variable].values)
            if target.variable in there else target
            for target in held_out.targets
        ))  # fmt: skip
    return replace(preparation, dataset=changed, held_out=held_out)


# ------------------------------------------------------------------------------------------------------------ targets


@dataclass(frozen=True, eq=False)
class _UnknownValues:
    """The values (R,) of an unknown part, their variances (R,), and the values and variances by equation."""

    values: FloatArray
    variances: FloatArray
    relative: float
    by_equation: Sequence[tuple[str, FloatArray, FloatArray]]


def _solve(template: EquationTemplate, dataset: Dataset, parameters: FloatArray) -> dict[str, _UnknownValues]:
    """Return the values of the unknown parts, by the equation that is each one's home.

    An equation with several unknown parts is solved when all but one are known from other equations.
    """
    first = len(template.names) + len(template.parameters)
    rows = dataset.inputs.shape[1]
    points = np.concatenate([
        dataset.inputs, np.repeat(parameters[:, None], rows, axis=1), np.zeros((len(template.unknowns), rows))
    ])  # fmt: skip
    found: dict[int, _UnknownValues] = {}
    while len(found) < len(template.unknowns):
        progress = False
        for index, unknown in enumerate(template.unknowns):
            if index in found:
                continue
            parts = [
                part
                for name in unknown.equations
                if all(other in found or other == index for other in template.unknowns_in(name))
                for part in _solve_one(template, dataset, points, name, index, found)
            ]
            if parts:
                found[index] = _combine(parts)
                points[first + index] = found[index].values
                progress = True
        if not progress:
            labels = ", ".join(one.label for index, one in enumerate(template.unknowns) if index not in found)
            raise UsageError(
                f"--equation: no equation can be solved for the unknown part {labels}; write each unknown part once in "
                "a side, not inside sin, cos, abs or an even power, and let each have an equation without other "
                "unknown parts"
            )
    return {template.unknowns[index].home: values for index, values in found.items()}


def _solve_one(
    template: EquationTemplate,
    dataset: Dataset,
    points: FloatArray,
    name: str,
    unknown: int,
    known: dict[int, _UnknownValues],
) -> list[tuple[str, FloatArray, FloatArray, float]]:
    """Return the values of an unknown part by one equation, and their variances; nothing if the equation is not
    differentiated or cannot be solved."""
    target = next((target for target in dataset.targets if target.variable == name), None)
    solved = template.solved_for(name, unknown)
    if target is None or solved is None:
        return []
    first = len(template.names) + len(template.parameters)
    here = points.copy()
    here[first + unknown] = target.values
    values = values_of(solved, here)
    here[first + unknown] = values
    side, error = template.sides[name], max(target.uncertainty, np.finfo(np.float64).eps) * target.standard_deviation
    with np.errstate(all="ignore"):
        variances = np.full(len(values), error * error)
        for other in template.unknowns_in(name):
            if other != unknown:
                slope = values_of(derivative(side, first + other), here)
                variances = variances + slope**2 * known[other].variances
        variances = variances / values_of(derivative(side, first + unknown), here) ** 2
    return [(name, values, variances, target.noise / max(target.uncertainty, 1e-300))]


def _combine(parts: Sequence[tuple[str, FloatArray, FloatArray, float]]) -> _UnknownValues:
    """Return the mean of the values by several equations, weighted by inverse variances."""
    with np.errstate(all="ignore"):
        weights = np.array([
            np.where(np.isfinite(values) & np.isfinite(variances), 1.0 / variances, 0.0)
            for _, values, variances, _ in parts
        ])  # fmt: skip
        total = weights.sum(axis=0)
        sums = sum(
            np.where(weight > 0.0, weight * values, 0.0) for weight, (_, values, *_) in zip(weights, parts, strict=True)
        )
        values, variances = sums / total, 1.0 / total
    by_equation = [(name, values, variances) for name, values, variances, _ in parts]
    return _UnknownValues(np.asarray(values), variances, max(part[3] for part in parts), by_equation)


def _useful_rows(unknowns: Sequence[_UnknownValues]) -> IntArray:
    """Return the rows of the search, which gives all rows equal weight.

    Rows are sorted by the variance of their value. The mean of the first n rows has the variance sum(v)/n^2; rows
    beyond its minimum add more error than information.
    """
    useful = np.ones(len(unknowns[0].values), np.bool_)
    for unknown in unknowns:
        is_finite = np.isfinite(unknown.values) & np.isfinite(unknown.variances)
        sizes = np.where(is_finite, unknown.variances, np.inf)
        order = np.argsort(sizes, kind="stable")
        finite = int(is_finite.sum())
        with np.errstate(all="ignore"):
            error = np.cumsum(sizes[order][:finite]) / np.arange(1, finite + 1) ** 2
        limit = sizes[order][int(np.argmin(error))] if finite else -np.inf
        useful &= sizes <= limit
    return np.flatnonzero(useful)


def _unknown_target(target: Target, unknown: _UnknownValues, rows: IntArray, *, is_exact: bool) -> Target:
    """Return the target of an unknown part over these rows.

    If parameters beside it were estimated, it does not count as free of noise: it has their errors.
    """
    values = np.ascontiguousarray(unknown.values[rows])
    mean, deviation = moments(values)
    error, _ = moments(np.sqrt(unknown.variances[rows]))
    scale = max(deviation, error, np.finfo(np.float64).eps * abs(mean)) or 1.0
    uncertainty = error / scale if is_exact else max(error / scale, CLEAN_UNCERTAINTY)
    noise = uncertainty * unknown.relative if target.noise else 0.0
    return Target(target.variable, target.lhs, values, uncertainty, scale, noise)


def _compare_equations(template: EquationTemplate, unknowns: dict[str, _UnknownValues]) -> list[str]:
    """Return a sentence for each unknown part whose equations do not agree about its values."""
    remarks = []
    for unknown in template.unknowns:
        parts = unknowns[unknown.home].by_equation
        for name, values, variances in parts[1:]:
            first, own, own_variances = parts[0]
            with np.errstate(all="ignore"):
                squares = (values - own) ** 2 / (variances + own_variances)
            squares = squares[np.isfinite(squares)]
            # derivatives of neighbouring rows have common errors, so only a large excess is a contradiction
            if len(squares) and float(np.median(squares)) > _CONTRADICTION**2:
                remarks.append(
                    f"The equations of '{first}' and '{name}' do not agree about the unknown part {unknown.label}: "
                    f"their values differ by {math.sqrt(float(np.median(squares))):.2g} times their uncertainty; check "
                    "signs and factors."
                )
    return remarks
